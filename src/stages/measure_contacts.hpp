// All that the ledger says of contacts, from one visit of the pairs: how many there are, the deepest overlap and the
// mean. The scale of the mean's exact sum is known only when all have been seen, so what it adds up is kept until then.
// The numbers are those of count_pairs, measure_max_overlap and measure_mean_overlap, bit for bit.
#pragma once

#include <algorithm>

#include "measure.hpp"

namespace fastcollide {

struct ContactSummary {
  std::int64_t contacts = 0;
  float max_overlap = 0;
  double mean_overlap = 0;
};

struct SlotContacts {
  std::int64_t contacts = 0;
  std::uint32_t deepest = 0;  // the bits of a float
  OverlapSize size;           // of those that can part

  struct Operation {
    FC_HOST_DEVICE SlotContacts operator()(SlotContacts a, const SlotContacts& b) const {
      return {a.contacts + b.contacts, Larger{}(a.deepest, b.deepest), OverlapSize::Operation{}(a.size, b.size)};
    }
  };
};

struct FindSlotContacts {
  Box box;
  GridView grid;
  CellNeighbors neighbors;
  SlotContacts* of_slots;
  // Overlaps as parts of the smaller radius, in any order, as far as there is room.
  double* parts;
  std::uint64_t room;
  std::uint64_t* count;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    SlotContacts found;
    float deepest = deepest_in_walls(grid, slot, box);
    auto visit = [&](std::int64_t other) {
      ++found.contacts;
      if (!can_part(grid, slot, other)) return;
      const float depth = overlap_of(grid, slot, other);
      const double part = part_of_smaller_radius(depth, grid, slot, other);
      deepest = larger(deepest, depth);
      found.size = OverlapSize::Operation{}(found.size, {1, part});
      const std::uint64_t place = atomic_add(count, 1);
      if (place < room) parts[place] = part;
    };
    visit_pairs_of(grid, neighbors, slot, visit);
    found.deepest = bits_of(deepest);
    of_slots[slot] = found;
  }
};

struct ContactsOfSlot {
  const SlotContacts* of_slots;
  FC_HOST_DEVICE SlotContacts operator()(std::int64_t slot) const { return of_slots[slot]; }
};

struct RoundPart {
  double scale;
  const double* parts;
  FC_HOST_DEVICE std::int64_t operator()(std::int64_t i) const { return round_to_int64(parts[i] * scale); }
};

// Memory that serves again.
template <Backend B>
struct ContactScratch {
  explicit ContactScratch(B& backend) : of_slots(backend), parts(backend), count(backend) {}

  typename B::template Buffer<SlotContacts> of_slots;
  typename B::template Buffer<double> parts;
  typename B::template Buffer<std::uint64_t> count;
};

template <Backend B>
ContactSummary measure_contacts(B& backend, const Box& box, const Grid<B>& grid, ContactScratch<B>& scratch) {
  constexpr std::int64_t most_kept = std::int64_t(1) << 24;  // 128 MiB
  const std::int64_t slots = grid.ids.size();
  scratch.of_slots.resize(slots);
  if (scratch.parts.size() < slots) scratch.parts.resize(std::min(2 * slots, most_kept));
  scratch.count.resize(1);
  backend.fill_zero(scratch.count.data(), 1);
  const std::int64_t room = scratch.parts.size();
  backend.for_each(
      slots, FindSlotContacts{box, view_of(grid), neighbors_in(grid), scratch.of_slots.data(), scratch.parts.data(),
                              static_cast<std::uint64_t>(room), scratch.count.data()});
  const SlotContacts all = backend.transform_reduce(slots, ContactsOfSlot{scratch.of_slots.data()}, SlotContacts{},
                                                    SlotContacts::Operation{});
  ContactSummary summary{all.contacts, float_of(all.deepest), 0};
  if (all.size.count == 0) return summary;
  if (all.size.count > room) {  // this time by other visits, the next time with more room
    scratch.parts.resize(std::min(all.size.count + all.size.count / 4, most_kept));
    summary.mean_overlap = measure_mean_overlap(backend, grid);
    return summary;
  }
  const int exponent = exponent_for(all.size.largest, all.size.count);
  const RoundPart round{std::ldexp(1.0, exponent), scratch.parts.data()};
  const std::int64_t sum = backend.transform_reduce(all.size.count, round, std::int64_t(0), Sum{});
  summary.mean_overlap = mean_of_sum(sum, exponent, all.size.count);
  return summary;
}

}  // namespace fastcollide
