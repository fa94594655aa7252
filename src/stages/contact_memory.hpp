// What rough contacts remember from substep to substep: see physics/tangential_spring.hpp.
//
// Each sphere has a row of entries, found by its id, so that no sort and no list moves them. A pair has one entry, in
// the row of the smaller of the two, which few larger ones can touch; both sides read it, and one writes it. A pass
// reads the rows that the pass before it has written. Entries of a row may come in any order, and those for which it
// has no place are in a hash table.
#pragma once

#include "../data.hpp"
#include "../physics/tangential_spring.hpp"
#include "fastcollide/world_state.hpp"

namespace fastcollide {

inline constexpr std::uint32_t places_in_row = 6;

// Tells with one read which entry is whose.
struct alignas(32) MemoryRow {
  std::uint32_t count;
  std::uint32_t partners[places_in_row];
};

// An entry is one of these: slide and the partner's id; where spheres resist rolling a second one follows: roll.
struct alignas(16) MemoryWord {
  Vec3 vector;
  std::uint32_t partner;
};

// The entries for which rows have no place, found by owner and partner: each is in the first free place from that of
// its hash on.
struct MemoryTable {
  std::uint64_t* keys;  // 0: of nobody
  MemoryWord* entries;
  std::uint32_t* counted;  // entries that were counted
  std::uint32_t* is_used;  // since a run began
  std::uint32_t hashes;    // a power of two
  std::uint32_t width;     // words in an entry

  // An entry that finds no free place in so many has none. The place behind all others stays free.
  static constexpr std::uint32_t most_steps = 64;
  FC_HOST_DEVICE static std::int64_t places_for(std::int64_t hashes) { return hashes + most_steps; }
  // One entry in so many is counted: to add to one word takes 2 ns, one after the other.
  static constexpr std::uint32_t bits_of_uncounted = 6;

  FC_HOST_DEVICE static std::uint64_t key_of(std::uint32_t owner, std::uint32_t partner) {
    return (std::uint64_t(owner) << 32 | partner) + 1;
  }
  static std::uint32_t owner_of(std::uint64_t key) { return static_cast<std::uint32_t>((key - 1) >> 32); }
  FC_HOST_DEVICE static std::uint32_t hash_of(std::uint32_t owner, std::uint32_t partner) {
    std::uint32_t hash = owner * 0x9E3779B1u + partner * 0x85EBCA77u;  // odd numbers without a pattern
    hash = (hash ^ hash >> 15) * 0xC2B2AE3Du;
    return hash ^ hash >> 13;
  }

  FC_HOST_DEVICE MemoryWord* entry(std::int64_t place) const { return entries + place * width; }
  // Null where there is none.
  FC_HOST_DEVICE const MemoryWord* find(std::uint32_t owner, std::uint32_t partner) const {
    const std::uint64_t key = key_of(owner, partner);
    std::uint32_t place = hash_of(owner, partner) & (hashes - 1);
    for (; keys[place] != 0; ++place) {
      if (keys[place] == key) return entry(place);
    }
    return nullptr;
  }
  // Null where there is no place.
  FC_HOST_DEVICE MemoryWord* add(std::uint32_t owner, std::uint32_t partner, WantedHashes* wanted) const {
    const std::uint32_t hash = hash_of(owner, partner);
    if (hash >> (32 - bits_of_uncounted) == 0) {
      const std::uint64_t about = std::uint64_t(atomic_add(counted, 1) + 1) << bits_of_uncounted;
      if (2 * about > hashes) atomic_max(&wanted->soon, 4 * about);
    }
    atomic_max(is_used, 1);
    // To look for a place in a full table takes long.
    if (atomic_read(&wanted->now) > hashes) return nullptr;
    const std::uint32_t first = hash & (hashes - 1);
    for (std::uint32_t step = 0; step + 1 < most_steps; ++step) {
      if (atomic_compare_exchange(keys + first + step, 0, key_of(owner, partner)) == 0) return entry(first + step);
    }
    atomic_max(&wanted->now, 2 * std::uint64_t(hashes));
    return nullptr;
  }
  // By all spheres, each its share.
  FC_HOST_DEVICE void clear(std::int64_t sphere, std::int64_t spheres) const {
    if (*is_used != 0) {
      for (std::int64_t place = sphere; place < places_for(hashes); place += spheres) keys[place] = 0;
    }
    if (sphere == 0) *counted = 0;
  }
};

// One copy of all rows.
struct MemoryRows {
  MemoryRow* rows;
  MemoryWord* entries;
  MemoryTable table;  // of what is too much for a row

  FC_HOST_DEVICE MemoryWord* entry(std::uint32_t owner, std::uint32_t place) const {
    return entries + (std::int64_t(owner) * places_in_row + place) * table.width;
  }
  FC_HOST_DEVICE ContactStretch read(const MemoryWord* entry) const {
    return {entry->vector, table.width > 1 ? entry[1].vector : Vec3{0, 0, 0}};
  }
  // None where there is no entry.
  FC_HOST_DEVICE ContactStretch find(std::uint32_t owner, std::uint32_t partner) const {
    const MemoryRow row = rows[owner];
    std::uint32_t place = places_in_row;
    FC_UNROLL
    for (std::uint32_t i = 0; i < places_in_row; ++i) {
      if (i < row.count && row.partners[i] == partner) place = i;
    }
    const MemoryWord* found = nullptr;
    if (place < places_in_row) {
      found = entry(owner, place);
    } else if (row.count > places_in_row) {
      found = table.find(owner, partner);
    }
    return found != nullptr ? read(found) : ContactStretch{{0, 0, 0}, {0, 0, 0}};
  }
  // A place for one more entry of a row; several lanes may ask at the same time.
  FC_HOST_DEVICE std::uint32_t take(std::uint32_t owner) const { return atomic_add(&rows[owner].count, 1); }
  // False where there is no place in the table.
  FC_HOST_DEVICE bool put(std::uint32_t owner, std::uint32_t place, std::uint32_t partner,
                          const ContactStretch& stretch, WantedHashes* wanted) const {
    MemoryWord* to = place < places_in_row ? entry(owner, place) : table.add(owner, partner, wanted);
    if (to == nullptr) return false;
    if (place < places_in_row) rows[owner].partners[place] = partner;
    to[0] = {stretch.slide, partner};
    if (table.width > 1) to[1] = {stretch.roll, partner};
    return true;
  }
  // By each sphere. `may_have_entries`: most rows have none, and need not even be read.
  FC_HOST_DEVICE void clear(std::uint32_t owner, bool may_have_entries) const {
    if (may_have_entries) rows[owner].count = 0;
  }
};

// The rows in one pass. Null pointers: nothing is remembered.
struct MemoryPass {
  MemoryRows from, to;
  MemoryRows cleared;  // those that the next pass will write
  WantedHashes* wanted;

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
  WantedHashes* wanted;

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
