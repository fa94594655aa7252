// Runs a pass by groups of slots: lanes that share one sphere, of a warp or of blocks, add up what each has gathered.
#pragma once

#include <cstdint>
#include <cstring>

#include "shared_pairs.cuh"

namespace fastcollide {

#if defined(__CUDACC__)
inline constexpr int group_run_threads = 128;

FC_HOST_DEVICE inline std::int64_t blocks_of(const SlotGroup& group) {
  return (group.count * group.lanes + group_run_threads - 1) / group_run_threads;
}

// The sum of the first lanes of all warps of a block, in the first one.
template <class Sum>
__device__ inline void combine_block(Sum& sum) {
  constexpr int warps = group_run_threads / 32;
  __shared__ alignas(16) unsigned char shared[warps * sizeof(Sum)];
  const int warp = static_cast<int>(threadIdx.x) / 32;
  if (threadIdx.x % 32 == 0) memcpy(shared + warp * sizeof sum, &sum, sizeof sum);
  __syncthreads();
  if (threadIdx.x != 0) return;
  for (int other = 1; other < warps; ++other) {
    Sum more;
    memcpy(&more, shared + other * sizeof more, sizeof more);
    sum.combine(more);
  }
}

// Where blocks that share a sphere leave their sums: a place for each block, and how many have come, with the first
// one.
struct SumsOfBlocks {
  unsigned char* sums;
  std::uint32_t* arrived;  // 0 between two kernels
};

// Whether the lanes of a warp share the pairs of all its spheres.
template <class Pass>
inline constexpr bool shares_pairs_in_groups =
    can_share_pairs<Pass> && requires(Pass pass, typename Pass::Sum sum) { pass.now().add_near(0, 0, sum); };

template <class Pass>
__device__ auto& pairs_of_this_warp() {
  __shared__ PairsOfWarp<typename Pass::Sum, places_for_near> pairs[group_run_threads / 32];
  return pairs[threadIdx.x / 32];
}

// As pass.gather(slot, lane); what `lanes` of a warp have found is added up in the first one.
template <int lanes, class Pass>
__device__ typename Pass::Sum gather_in_warp(const Pass& pass, std::int64_t slot, Lane lane, bool is_mine) {
  using Sum = typename Pass::Sum;
  if constexpr (shares_pairs_in_groups<Pass> && lanes > 1) {
    return gather_by_pairs_as_found<lanes>(pass, pairs_of_this_warp<Pass>(), slot, lane, is_mine);
  } else {
    Sum sum;
    if (is_mine) sum = pass.gather(slot, lane);
#pragma unroll
    for (int distance = lanes / 2; distance > 0; distance /= 2) sum.combine(of_lane(sum, distance));
    return sum;
  }
}

// Some threads of a warp share one sphere, or one has it for itself.
template <int lanes, class Pass>
__device__ void run_in_warp(const Pass& pass, const SlotGroup& group, std::int64_t block) {
  const std::int64_t row = block * group_run_threads + threadIdx.x, i = row / lanes;
  const bool is_mine = i < group.count;
  const Lane lane{static_cast<int>(threadIdx.x % lanes), lanes};
  const std::int64_t slot = group.first + (is_mine ? i : 0);
  const auto sum = gather_in_warp<lanes>(pass, slot, lane, is_mine);
  if (is_mine && lane.index == 0) pass.finish(slot, sum);
}

// Whole blocks share one sphere. The last of them that is done adds up what all have found.
template <class Pass>
__device__ void run_in_blocks(const Pass& pass, const SlotGroup& group, std::int64_t block, SumsOfBlocks blocks) {
  using Sum = typename Pass::Sum;
  const int parts = group.lanes / group_run_threads, part = static_cast<int>(block % parts);
  const std::int64_t slot = group.first + block / parts;
  const Lane lane{part * group_run_threads + static_cast<int>(threadIdx.x), group.lanes};
  Sum sum = gather_in_warp<32>(pass, slot, lane, true);
  combine_block(sum);
  if (threadIdx.x != 0) return;
  if (parts > 1) {
    const unsigned first = blockIdx.x - static_cast<unsigned>(part);
    memcpy(blocks.sums + blockIdx.x * sizeof sum, &sum, sizeof sum);
    __threadfence();
    if (atomicAdd(blocks.arrived + first, 1u) + 1 < static_cast<unsigned>(parts)) return;
    __threadfence();
    for (int i = 0; i < parts; ++i) {
      if (i == part) continue;
      Sum more;
      memcpy(&more, blocks.sums + (first + static_cast<unsigned>(i)) * sizeof more, sizeof more);
      sum.combine(more);
    }
    blocks.arrived[first] = 0;
  }
  pass.finish(slot, sum);
}

// All groups in one kernel: the few large spheres take long, and the small ones need not wait for them.
template <class Pass>
__global__ void __launch_bounds__(group_run_threads, Pass::has_friction ? 4 : 5)
    run_groups(const __grid_constant__ SlotGroups groups, SumsOfBlocks blocks, const __grid_constant__ Pass pass) {
  std::int64_t block = blockIdx.x;
  int k = 0;
  for (; block >= blocks_of(groups.groups[k]); ++k) block -= blocks_of(groups.groups[k]);
  const SlotGroup group = groups.groups[k];
  switch (group.lanes) {
    case 1:
      return run_in_warp<1>(pass, group, block);
    case 8:
      return run_in_warp<8>(pass, group, block);
    case 32:
      return run_in_warp<32>(pass, group, block);
    default:
      return run_in_blocks(pass, group, block, blocks);
  }
}
#endif

}  // namespace fastcollide
