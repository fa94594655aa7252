// The memory of rough contacts on one backend: three copies of it, and how it is saved.
#pragma once

#include <algorithm>
#include <tuple>
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
    chained_places_ = std::max(chained_places_, (count <= 1 << 24 ? count / 2 : count / 16) + 64);
    resize_copies(count);
  }

  // Before the first of all passes of a run; `watch` is on the device. The last of them writes copy 2, however many
  // they are: the passes that many frames repeat then find the same addresses in every other run.
  MemoryCopies start_run(Watch* watch, std::int64_t passes) {
    if (!is_kept()) return {};
    const int first = passes % 2 == 0 ? 1 : 2;
    for (int i : {1, 2}) {
      backend_.fill_zero(copies_[i].rows.data(), copies_[i].rows.size());
      backend_.fill_zero(copies_[i].chained_count.data(), 1);
    }
    return {{view(copies_[0]), view(copies_[first]), view(copies_[3 - first])}, &watch->memory_wanted};
  }
  // After a run: false when it found no place for some entry. It has to be run again; now there is room.
  bool had_room(const Watch& watch) {
    const auto wanted = static_cast<std::int64_t>(watch.memory_wanted);
    if (wanted <= chained_places_) return true;
    make_room(wanted);
    return false;
  }
  // What the last pass of a run has written is what is known from now on. Where there is little room left the next run
  // gets more: to run it twice would take longer.
  void end_run(const Watch& watch, std::int64_t passes) {
    if (!is_kept() || passes == 0) return;
    std::swap(copies_[0], copies_[2]);
    const auto wanted = static_cast<std::int64_t>(watch.memory_wanted);
    if (4 * wanted <= 3 * chained_places_) return;
    try {
      make_room(wanted);
    } catch (const OutOfMemory&) {
    }
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
    std::vector<MemoryWord> entries, chained;
    std::vector<std::uint32_t> chained_before;
    read(known.rows, rows);
    read(known.entries, entries);
    read(known.chained, chained);
    read(known.chained_before, chained_before);
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
      for (std::uint32_t next = rows[owner].last_chained; next != 0; next = chained_before[next - 1]) {
        add(&chained[std::size_t(next - 1) * width_]);
      }
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
    std::vector<MemoryRow> rows(static_cast<std::size_t>(count), MemoryRow{});
    std::vector<MemoryWord> entries(rows.size() * places_in_row * width, MemoryWord{{0, 0, 0}, 0}), chained;
    std::vector<std::uint32_t> chained_before;
    for (std::size_t i = 0; i < state.owner.size(); ++i) {
      MemoryRow& row = rows[state.owner[i]];
      MemoryWord entry[2] = {{vector_at(state.slide, i), state.partner[i]}, {{0, 0, 0}, state.partner[i]}};
      if (width > 1) entry[1].vector = vector_at(state.roll, i);
      if (row.count < places_in_row) {
        row.partners[row.count] = state.partner[i];
        std::copy_n(entry, width, &entries[(std::size_t(state.owner[i]) * places_in_row + row.count) * width]);
      } else {
        chained.insert(chained.end(), entry, entry + width);
        chained_before.push_back(row.last_chained);
        row.last_chained = static_cast<std::uint32_t>(chained_before.size());
      }
      ++row.count;
    }
    chained_places_ = static_cast<std::int64_t>(chained_before.size());
    resize(count, width);
    const auto write = [&](auto& buffer, const auto& host) {
      backend_.copy_to_device(buffer.data(), host.data(), static_cast<std::int64_t>(host.size()));
    };
    write(copies_[0].rows, rows);
    write(copies_[0].entries, entries);
    write(copies_[0].chained, chained);
    write(copies_[0].chained_before, chained_before);
    backend_.synchronize();
  }

 private:
  struct Copy {
    explicit Copy(B& backend)
        : rows(backend), entries(backend), chained(backend), chained_before(backend), chained_count(backend) {}
    typename B::template Buffer<MemoryRow> rows;
    typename B::template Buffer<MemoryWord> entries, chained;
    typename B::template Buffer<std::uint32_t> chained_before, chained_count;
  };

  void make_room(std::int64_t wanted) {
    const std::int64_t before = std::exchange(chained_places_, 2 * wanted);
    try {
      resize_copies(copies_[0].rows.size());
    } catch (...) {
      chained_places_ = before;
      throw;
    }
  }
  // The rows last: where memory runs out on the way, the next call tries again.
  void resize_copies(std::int64_t count) {
    for (Copy& copy : copies_) {
      resize_with_zeros(copy.entries, count * places_in_row * width_);
      resize_with_zeros(copy.chained, chained_places_ * width_);
      resize_with_zeros(copy.chained_before, chained_places_);
      resize_with_zeros(copy.chained_count, 1);
    }
    for (int i : {1, 2, 0}) resize_with_zeros(copies_[i].rows, count);
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
            copy.chained.data(),
            copy.chained_before.data(),
            copy.chained_count.data(),
            static_cast<std::uint32_t>(chained_places_),
            width_};
  }
  static void put(std::vector<float>& numbers, Vec3 vector) {
    numbers.insert(numbers.end(), {vector.x, vector.y, vector.z});
  }
  static Vec3 vector_at(const std::vector<float>& numbers, std::size_t i) {
    return {numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]};
  }

  B& backend_;
  std::int64_t chained_places_ = 0;
  std::uint32_t width_ = 1;
  Copy copies_[3] = {Copy(backend_), Copy(backend_), Copy(backend_)};
};

}  // namespace fastcollide
