// The memory of rough contacts on one backend: three copies of it, and how it is saved.
#pragma once

#include <algorithm>
#include <bit>
#include <utility>
#include <vector>

#include "fastcollide/world_state.hpp"
#include "stages/contact_memory.hpp"

namespace fastcollide {

template <Backend B>
class ContactMemory {
 public:
  explicit ContactMemory(B& backend) : backend_(backend) {}

  bool is_kept() const { return copies_[0].rows.size() > 0; }

  // Room for all spheres; new ones remember nothing. width: words in an entry, the same in every call.
  void resize(std::int64_t count, std::uint32_t width) {
    width_ = width;
    if (copies_[0].rows.size() == count) return;
    // Room from the start for a pile, as frames that found none are run again; of very many spheres memory is short.
    want_hashes(static_cast<std::uint64_t>(count <= 1 << 24 ? count / 2 : count / 16));
    for (Copy& copy : copies_) {
      if (copy.hashes == 0) renew_table(copy);
      resize_with_zeros(copy.entries, count * places_in_row * width_);
    }
    // The rows last: where memory runs out on the way, the next call tries again.
    for (int i : {1, 2, 0}) resize_with_zeros(copies_[i].rows, count);
  }

  // Before the first of all passes of a run; `watch` is on the device. The last of them writes copy 2, however many
  // they are: the passes that many frames repeat then find the same addresses in every other run.
  MemoryCopies start_run(Watch* watch, std::int64_t passes) {
    if (!is_kept()) return {};
    const int first = passes % 2 == 0 ? 1 : 2;
    for (int i : {1, 2}) {
      Copy& copy = copies_[i];
      if (copy.hashes < hashes_) grow_table(copy);
      backend_.fill_zero(copy.rows.data(), copy.rows.size());
      backend_.fill_zero(copy.keys.data(), copy.keys.size());
      backend_.fill_zero(copy.counts.data(), copy.counts.size());
    }
    return {{view(copies_[0]), view(copies_[first]), view(copies_[3 - first])}, &watch->memory_wanted};
  }
  // After a run: false when it found no place for some entry. It has to be run again; then there is room.
  bool had_room(const Watch& watch) {
    const WantedHashes& wanted = watch.memory_wanted;
    if (wanted.now == 0) return true;
    if (wanted.now > most_hashes) {
      throw OutOfMemory("more rough contacts than their memory can have: 2^31 in its table");
    }
    want_hashes(std::max(wanted.now, wanted.soon));
    needed_hashes_ = hashes_;
    return false;
  }
  // After a run: what its last pass has written is what is known from now on. Where there is little room left the next
  // run gets more: to run it twice would take longer.
  void end_run(const Watch& watch, std::int64_t passes) {
    if (!is_kept() || passes == 0) return;
    std::swap(copies_[0], copies_[2]);
    want_hashes(watch.memory_wanted.soon);
  }

  // In the order of owner and partner, whatever order the entries have here; those that hold nothing are left out.
  void save(ContactState& state) {
    state = {};
    if (!is_kept()) return;
    const Copy& known = copies_[0];
    const auto read = [&](const auto& buffer, auto& host) {
      host.resize(static_cast<std::size_t>(buffer.size()));
      backend_.copy_to_host(host.data(), buffer.data(), buffer.size());
    };
    std::vector<MemoryRow> rows;
    std::vector<MemoryWord> entries, table_entries;
    std::vector<std::uint64_t> keys;
    read(known.rows, rows);
    read(known.entries, entries);
    read(known.keys, keys);
    read(known.table_entries, table_entries);
    std::vector<std::pair<std::uint32_t, const MemoryWord*>> others;  // of the table, by their owners
    for (std::size_t place = 0; place < keys.size(); ++place) {
      if (keys[place] != 0) others.emplace_back(MemoryTable::owner_of(keys[place]), &table_entries[place * width_]);
    }
    std::sort(others.begin(), others.end());
    auto other = others.begin();
    std::vector<std::pair<std::uint32_t, const MemoryWord*>> row;
    for (std::size_t owner = 0; owner < rows.size(); ++owner) {
      row.clear();
      const auto add = [&](const MemoryWord* entry) {
        const ContactStretch stretch{entry[0].vector, width_ > 1 ? entry[1].vector : Vec3{0, 0, 0}};
        if (!stretch.is_none()) row.emplace_back(entry->partner, entry);
      };
      for (std::uint32_t i = 0; i < std::min(rows[owner].count, places_in_row); ++i) {
        add(&entries[(owner * places_in_row + i) * width_]);
      }
      for (; other != others.end() && other->first == owner; ++other) add(other->second);
      std::sort(row.begin(), row.end());
      for (const auto& [partner, entry] : row) {
        state.owner.push_back(static_cast<std::uint32_t>(owner));
        state.partner.push_back(partner);
        put(state.slide, entry[0].vector);
        if (width_ > 1) put(state.roll, entry[1].vector);
      }
    }
  }

  // Into a world of as many spheres, which remembers nothing so far.
  void restore(const ContactState& state, std::int64_t count, std::uint32_t width) {
    std::vector<std::int64_t> sizes(static_cast<std::size_t>(count), 0);
    for (std::uint32_t owner : state.owner) ++sizes[owner];
    std::uint64_t in_table = 0;
    for (std::int64_t size : sizes) {
      in_table += static_cast<std::uint64_t>(std::max<std::int64_t>(size - places_in_row, 0));
    }
    want_hashes(4 * in_table);
    resize(count, width);

    std::vector<MemoryRow> rows(sizes.size(), MemoryRow{});
    std::vector<MemoryWord> entries(rows.size() * places_in_row * width, MemoryWord{{0, 0, 0}, 0});
    std::vector<std::uint64_t> keys(static_cast<std::size_t>(copies_[0].keys.size()), 0);
    std::vector<MemoryWord> table_entries(keys.size() * width, MemoryWord{{0, 0, 0}, 0});
    std::uint32_t counts[2] = {};
    const MemoryTable table{
        keys.data(), table_entries.data(), counts, counts + 1, static_cast<std::uint32_t>(copies_[0].hashes), width};
    const MemoryRows host{rows.data(), entries.data(), table};
    WantedHashes wanted;
    for (std::size_t i = 0; i < state.owner.size(); ++i) {
      const std::uint32_t owner = state.owner[i];
      const Vec3 roll = width > 1 ? vector_at(state.roll, i) : Vec3{0, 0, 0};
      if (host.put(owner, host.take(owner), state.partner[i], {vector_at(state.slide, i), roll}, &wanted)) continue;
      want_hashes(2 * static_cast<std::uint64_t>(copies_[0].hashes));  // entries lay too close together
      renew_table(copies_[0]);
      return restore(state, count, width);
    }
    const auto write = [&](auto& buffer, const auto& from) {
      backend_.copy_to_device(buffer.data(), from.data(), static_cast<std::int64_t>(from.size()));
    };
    write(copies_[0].rows, rows);
    write(copies_[0].entries, entries);
    write(copies_[0].keys, keys);
    write(copies_[0].table_entries, table_entries);
    backend_.synchronize();
  }

 private:
  struct Copy {
    explicit Copy(B& backend)
        : rows(backend), entries(backend), table_entries(backend), keys(backend), counts(backend) {}
    typename B::template Buffer<MemoryRow> rows;
    typename B::template Buffer<MemoryWord> entries, table_entries;
    typename B::template Buffer<std::uint64_t> keys;
    typename B::template Buffer<std::uint32_t> counts;  // of the table
    std::int64_t hashes = 0;                            // likewise
  };

  static constexpr std::uint64_t most_hashes = std::uint64_t(1) << 31;

  // Of the tables that passes write, from the next run on.
  void want_hashes(std::uint64_t wanted) {
    const std::uint64_t hashes = std::clamp<std::uint64_t>(std::bit_ceil(wanted), 64, most_hashes);
    hashes_ = std::max(hashes_, static_cast<std::int64_t>(hashes));
  }
  // Empty then.
  void renew_table(Copy& copy) {
    copy.hashes = 0;
    copy.keys = typename B::template Buffer<std::uint64_t>(backend_);
    copy.table_entries = typename B::template Buffer<MemoryWord>(backend_);
    const std::int64_t places = MemoryTable::places_for(hashes_);
    resize_with_zeros(copy.table_entries, places * width_);
    resize_with_zeros(copy.keys, places);
    resize_with_zeros(copy.counts, 2);
    copy.hashes = hashes_;
  }
  // More than were needed so far are a wish.
  void grow_table(Copy& copy) {
    const std::int64_t before = copy.hashes;
    try {
      renew_table(copy);
    } catch (const OutOfMemory&) {
      if (before < needed_hashes_) throw;
      hashes_ = before;
      renew_table(copy);
    }
  }
  // A row is read whole, with the names of partners that it does not have, and where a buffer grows all of
  // it is copied.
  template <class Buffer>
  void resize_with_zeros(Buffer& buffer, std::int64_t count) {
    const std::int64_t known = buffer.size();
    buffer.resize(count);
    if (count > known) backend_.fill_zero(buffer.data() + known, count - known);
  }
  MemoryRows view(Copy& copy) {
    return {copy.rows.data(),
            copy.entries.data(),
            {copy.keys.data(), copy.table_entries.data(), copy.counts.data(), copy.counts.data() + 1,
             static_cast<std::uint32_t>(copy.hashes), width_}};
  }
  static void put(std::vector<float>& numbers, Vec3 vector) {
    numbers.insert(numbers.end(), {vector.x, vector.y, vector.z});
  }
  static Vec3 vector_at(const std::vector<float>& numbers, std::size_t i) {
    return {numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]};
  }

  B& backend_;
  std::int64_t hashes_ = 0, needed_hashes_ = 0;  // of a table, powers of two
  std::uint32_t width_ = 1;
  Copy copies_[3] = {Copy(backend_), Copy(backend_), Copy(backend_)};
};

}  // namespace fastcollide
