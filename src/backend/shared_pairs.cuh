// Lanes of a warp share the pairs of all its spheres: some have many, most have few.
#pragma once

#include <cstdint>

#include "../math.hpp"
#include "lanes.cuh"

namespace fastcollide {

// Where a contact takes long: without friction this gains nothing.
template <class Pass>
inline constexpr bool can_share_pairs = Pass::has_friction && sums_are_integers;

// What each lane has found, and what was found of the next 32 pairs.
template <class Sum, std::uint32_t places>
struct PairsOfWarp {
  static constexpr std::uint32_t columns = Sum::words;

  std::uint32_t near[places][32];  // of each lane
  std::uint32_t ends[32], slots[32];
  std::uint64_t terms[columns][33];  // of each pair: one place more, so that columns do not wait for each other

  __device__ void put(std::uint32_t lane, const Sum& sum) {
    std::uint64_t words[columns];
    sum.write(words);
#pragma unroll
    for (std::uint32_t i = 0; i < columns; ++i) terms[i][lane] = words[i];
  }
  // Adds up each column between two bits of `lasts`, into the place of the second one. Half the warp does the first 16
  // places.
  __device__ void add_up(std::uint32_t lane, std::uint32_t lasts) {
    static_assert(columns <= 16);
    std::uint64_t* column = terms[lane % 16];
    if (lane % 16 >= columns) return;
    const bool is_second = lane >= 16;
    std::uint32_t first = is_second ? 32 - static_cast<std::uint32_t>(__clz(static_cast<int>(lasts & 0xFFFFu))) : 0;
    for (lasts &= is_second ? 0xFFFF0000u : 0xFFFFu; lasts != 0; lasts &= lasts - 1) {
      const auto last = static_cast<std::uint32_t>(__ffs(static_cast<int>(lasts)) - 1);
      std::uint64_t sum = column[first];
#pragma unroll 4
      for (std::uint32_t k = first + 1; k <= last; ++k) sum += column[k];
      column[last] = sum;
      first = last + 1;
    }
  }
  __device__ void add_to(Sum& sum, std::uint32_t place) const {
    std::uint64_t words[columns];
#pragma unroll
    for (std::uint32_t i = 0; i < columns; ++i) words[i] = terms[i][place];
    sum.add(words);
  }
};

// Adds to the sum of each sphere, in its first lane, those of its pairs: each of its `lanes` has found `own` of them.
// A lane works on one pair at a time, whoever of the warp has it.
template <int lanes, class Pass, class Pairs>
__device__ void add_pairs(const Pass& pass, Pairs& shared, std::uint32_t slot, std::uint32_t own,
                          typename Pass::Sum& sum) {
  constexpr unsigned warp = 0xFFFFFFFFu;
  const std::uint32_t lane = threadIdx.x % 32, first_lane = lane / lanes * lanes;
  std::uint32_t end = own;
#pragma unroll
  for (std::uint32_t distance = 1; distance < 32; distance *= 2) {
    const std::uint32_t before = __shfl_up_sync(warp, end, distance);
    if (lane >= distance) end += before;
  }
  const std::uint32_t all = __shfl_sync(warp, end, 31);
  shared.ends[lane] = end;
  shared.slots[lane] = slot;
  // Of the sphere:
  const std::uint32_t begin = __shfl_sync(warp, end - own, first_lane);
  end = __shfl_sync(warp, end, first_lane + lanes - 1);
  __syncwarp();
  for (std::uint32_t base = 0; base < all; base += 32) {
    const std::uint32_t next = min(base + 32, all), pair = base + lane;
    auto found = pass.now().nothing_yet();
    bool is_last = false;
    if (pair < next) {
      std::uint32_t owner = 0;  // the first lane whose pairs end behind this one
#pragma unroll
      for (std::uint32_t step = 16; step > 0; step /= 2) {
        if (shared.ends[owner + step - 1] <= pair) owner += step;
      }
      const std::uint32_t first = owner == 0 ? 0 : shared.ends[owner - 1];
      is_last = pair + 1 == next || pair + 1 == shared.ends[owner / lanes * lanes + lanes - 1];
      pass.now().add_near(shared.slots[owner], shared.near[pair - first][owner], found);
    }
    const std::uint32_t lasts = __ballot_sync(warp, is_last);
    std::uint32_t impacts = __ballot_sync(warp, found.fastest.is_any());
    shared.put(lane, found);
    __syncwarp();
    shared.add_up(lane, lasts);
    __syncwarp();
    if (lane == first_lane && begin < next && end > base && begin < end) shared.add_to(sum, min(end, next) - 1 - base);
    for (; impacts != 0; impacts &= impacts - 1) {  // few
      const auto from = static_cast<std::uint32_t>(__ffs(static_cast<int>(impacts)) - 1);
      const auto other = of_lane(found.fastest, static_cast<int>(from ^ lane));
      if (base + from >= begin && base + from < end) sum.fastest.keep_faster(other);
    }
    __syncwarp();
  }
}

inline constexpr std::uint32_t places_for_pairs = 24;  // with 16, 1,000,000 that lie took 5 % longer, with 32 as long

// As here.gather(self, slot, lane) of `lanes` lanes, all added up in the first one. They all find who is near first.
template <int lanes, class Pass, class Here, class Sphere>
__device__ typename Pass::Sum gather_by_pairs(const Pass& pass, const Here& here,
                                              PairsOfWarp<typename Pass::Sum, places_for_pairs>& shared,
                                              const Sphere& self, std::int64_t slot, bool is_mine) {
  const Lane lane{static_cast<int>(threadIdx.x % lanes), lanes};
  auto sum = here.nothing_yet();
  bool has_more = is_mine && here.is_free(self);
  for (std::uint32_t round = 0; __any_sync(0xFFFFFFFFu, has_more); ++round) {
    std::uint32_t found = 0;
    auto keep = [&](std::uint32_t other) {
      if (found / places_for_pairs == round) shared.near[found % places_for_pairs][threadIdx.x % 32] = other;
      ++found;
    };
    if (has_more) here.neighbors.visit(here.grid, slot, self.position, lane, keep);
    const std::uint32_t before = round * places_for_pairs;
    add_pairs<lanes>(pass, shared, static_cast<std::uint32_t>(slot),
                     found > before ? min(found - before, places_for_pairs) : 0, sum);
    has_more = found > before + places_for_pairs;
  }
  if (is_mine && lane.index == 0) here.add_walls(self, slot, sum);
  return sum;
}

inline constexpr std::uint32_t places_for_near = 32;

// Likewise where who is near is found by a search that all lanes of the warp make in step: pairs are worked on when one
// of the lanes has no place left.
template <int lanes, class Pass>
__device__ typename Pass::Sum gather_by_pairs_as_found(const Pass& pass,
                                                       PairsOfWarp<typename Pass::Sum, places_for_near>& shared,
                                                       std::int64_t slot, Lane lane, bool is_mine) {
  const auto here = pass.now();
  const auto self = here.load(slot);
  auto sum = here.nothing_yet();
  const auto near = [&](std::uint32_t k) -> std::uint32_t& { return shared.near[k][threadIdx.x % 32]; };
  const auto flush = [&](std::uint32_t found) {
    add_pairs<lanes>(pass, shared, static_cast<std::uint32_t>(slot), found, sum);
  };
  here.neighbors.search(here.grid, slot, self.position, lane, LanesTogether::of_warp(), is_mine && here.is_free(self),
                        near, places_for_near, flush);
  if (is_mine && lane.index == 0) here.add_walls(self, slot, sum);
  return sum;
}

}  // namespace fastcollide
