// What rough contacts remember from substep to substep: see physics/tangential_spring.hpp.
//
// Each sphere has a row of entries, found by its id, so that no sort and no list moves them. A pair has one entry, in
// the row of the smaller of the two, which few larger ones can touch; both sides read it, and one writes it. A pass
// reads the rows that the pass before it has written. Entries of a row may come in any order, and those for which it
// has no place are chained.
#pragma once

#include "../data.hpp"
#include "../physics/tangential_spring.hpp"
#include "fastcollide/world_state.hpp"

namespace fastcollide {

inline constexpr std::uint32_t places_in_row = 6;

// Tells with one read which entry is whose.
struct alignas(32) MemoryRow {
  std::uint32_t count;
  std::uint32_t last_chained;  // 1 + its place; 0: none
  std::uint32_t partners[places_in_row];
};

// An entry is one of these: slide and the partner's id; where spheres resist rolling a second one follows: roll.
struct alignas(16) MemoryWord {
  Vec3 vector;
  std::uint32_t partner;
};

// One copy of all rows.
struct MemoryRows {
  MemoryRow* rows;
  MemoryWord* entries;
  MemoryWord* chained;
  std::uint32_t* chained_before;  // of each chained entry: as last_chained
  std::uint32_t* chained_count;
  std::uint32_t chained_places;
  std::uint32_t width;  // words in an entry

  FC_HOST_DEVICE ContactStretch read(const MemoryWord* entry) const {
    return {entry->vector, width > 1 ? entry[1].vector : Vec3{0, 0, 0}};
  }
  // None where there is no entry.
  FC_HOST_DEVICE ContactStretch find(std::uint32_t owner, std::uint32_t partner) const {
    const MemoryRow row = rows[owner];
    std::uint32_t place = places_in_row;
    FC_UNROLL
    for (std::uint32_t i = 0; i < places_in_row; ++i) {
      if (i < row.count && row.partners[i] == partner) place = i;
    }
    if (place < places_in_row) return read(entries + (std::int64_t(owner) * places_in_row + place) * width);
    for (std::uint32_t next = row.last_chained; next != 0; next = chained_before[next - 1]) {
      const MemoryWord* entry = chained + std::int64_t(next - 1) * width;
      if (entry->partner == partner) return read(entry);
    }
    return {{0, 0, 0}, {0, 0, 0}};
  }
  // A place for one more entry of a row; several lanes may ask at the same time.
  FC_HOST_DEVICE std::uint32_t take(std::uint32_t owner) const { return atomic_add(&rows[owner].count, 1); }
  // Returns 0 or, where there is no chained place left, how many there should be; as the last quarter of them is taken,
  // some are told how many are in use.
  FC_HOST_DEVICE std::uint32_t put(std::uint32_t owner, std::uint32_t place, std::uint32_t partner,
                                   const ContactStretch& stretch) const {
    std::uint32_t told = 0;
    MemoryWord* entry = entries + (std::int64_t(owner) * places_in_row + place) * width;
    if (place >= places_in_row) {
      const std::uint32_t more = atomic_add(chained_count, 1);
      if (more >= chained_places) return more + 1;
      if (more > chained_places - chained_places / 4 && more % 64 == 0) told = more;
      entry = chained + std::int64_t(more) * width;
      chained_before[more] = atomic_exchange(&rows[owner].last_chained, more + 1);
    } else {
      rows[owner].partners[place] = partner;
    }
    entry[0] = {stretch.slide, partner};
    if (width > 1) entry[1] = {stretch.roll, partner};
    return told;
  }
  // `may_have_entries`: most rows have none, and need not even be read.
  FC_HOST_DEVICE void clear(std::uint32_t owner, bool may_have_entries) const {
    if (may_have_entries) rows[owner].count = rows[owner].last_chained = 0;
    if (owner == 0) *chained_count = 0;
  }
};

// The rows in one pass. Null pointers: nothing is remembered.
struct MemoryPass {
  MemoryRows from, to;
  MemoryRows cleared;     // those that the next pass will write
  std::uint64_t* wanted;  // most chained entries that a pass had, where room for them is short

  FC_HOST_DEVICE bool is_kept() const { return from.rows != nullptr; }
  MemoryPass next() const { return {to, cleared, to, wanted}; }
  FC_HOST_DEVICE static bool is_owner(const Sphere& self, const Sphere& other) {
    return is_fixed(other.mass) || self.radius < other.radius || (self.radius == other.radius && self.id < other.id);
  }
  FC_HOST_DEVICE ContactStretch of_pair(const Sphere& self, const Sphere& other) const {
    if (!is_kept()) return {};
    const bool is_own = is_owner(self, other);  // one search for both, as both sides of pairs share a warp
    const ContactStretch found = from.find(is_own ? self.id : other.id, is_own ? other.id : self.id);
    return is_own ? found : -found;
  }
  FC_HOST_DEVICE ContactStretch of_wall(const Sphere& self, std::uint32_t wall) const {
    if (!is_kept()) return {};
    return from.find(self.id, wall);
  }
};

// Three copies: what was known before a run, which stays until the run has ended well, and two that its passes read and
// write in turn.
struct MemoryCopies {
  MemoryRows rows[3];
  std::uint64_t* wanted;

  // The copy that a pass writes; passes of a run are counted from 0.
  FC_HOST_DEVICE static int written_by(std::uint32_t pass) { return 1 + static_cast<int>(pass % 2); }
  FC_HOST_DEVICE MemoryPass of_pass(std::uint32_t pass) const {
    const int to = written_by(pass);
    // Written out, as an index that is not known when this is compiled would move all of it out of the registers.
    const MemoryRows& written = to == 1 ? rows[1] : rows[2];
    const MemoryRows& other = to == 1 ? rows[2] : rows[1];
    return {pass == 0 ? rows[0] : other, written, other, wanted};
  }
};

}  // namespace fastcollide
