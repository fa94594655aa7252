// Lanes that share one sphere, of a warp or of blocks, add up what each has gathered.
#pragma once

#include <cstdint>
#include <cstring>

#include "lane.hpp"

namespace fastcollide {

#if defined(__CUDACC__)
// The sum of the lane whose number differs from this one's in the bit `distance`.
template <class Sum>
__device__ inline Sum of_lane(const Sum& sum, int distance) {
  static_assert(sizeof(Sum) % 4 == 0);
  constexpr int words = sizeof(Sum) / 4;
  std::uint32_t mine[words], other[words];
  memcpy(mine, &sum, sizeof sum);
#pragma unroll
  for (int i = 0; i < words; ++i) other[i] = __shfl_xor_sync(0xFFFFFFFFu, mine[i], distance);
  Sum result;
  memcpy(&result, other, sizeof result);
  return result;
}

inline constexpr int group_run_threads = 128;

FC_HOST_DEVICE inline std::int64_t blocks_of(const SlotGroup& group) {
  return (group.count * group.lanes + group_run_threads - 1) / group_run_threads;
}

// The sum of all lanes of a block, in its first lane.
template <class Sum>
__device__ inline void combine_block(Sum& sum) {
  constexpr int warps = group_run_threads / 32;
  __shared__ alignas(16) unsigned char shared[warps * sizeof(Sum)];
#pragma unroll
  for (int distance = 16; distance > 0; distance /= 2) sum.combine(of_lane(sum, distance));
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

// Some threads of a warp share one sphere, or one has it for itself.
template <int lanes, class Pass>
__device__ void run_in_warp(const Pass& pass, const SlotGroup& group, std::int64_t block) {
  const std::int64_t row = block * group_run_threads + threadIdx.x, slot = group.first + row / lanes;
  const bool is_mine = row / lanes < group.count;
  typename Pass::Sum sum;
  if (is_mine) sum = pass.gather(slot, Lane{static_cast<int>(threadIdx.x % lanes), lanes});
  if constexpr (lanes > 1) {
#pragma unroll
    for (int distance = lanes / 2; distance > 0; distance /= 2) sum.combine(of_lane(sum, distance));
  }
  if (is_mine && threadIdx.x % lanes == 0) pass.finish(slot, sum);
}

// Whole blocks share one sphere. The last of them that is done adds up what all have found.
template <class Pass>
__device__ void run_in_blocks(const Pass& pass, const SlotGroup& group, std::int64_t block, SumsOfBlocks blocks) {
  using Sum = typename Pass::Sum;
  const int parts = group.lanes / group_run_threads, part = static_cast<int>(block % parts);
  const std::int64_t slot = group.first + block / parts;
  Sum sum = pass.gather(slot, Lane{part * group_run_threads + static_cast<int>(threadIdx.x), group.lanes});
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
