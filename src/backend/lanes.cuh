// Lanes of a warp that share one sphere add up what each has gathered.
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

// The sum of all lanes of a block, in its first lane.
template <int lanes, class Sum>
__device__ inline void combine_block(Sum& sum) {
  constexpr int warps = lanes / 32;
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

// `lanes` threads share one sphere: some of a warp, or a block.
template <int lanes, class Pass>
__global__ void __launch_bounds__(lanes > 128 ? lanes : 128)
    run_for_each_shared(std::int64_t first, std::int64_t count, Pass pass) {
  const std::int64_t row = std::int64_t(blockIdx.x) * blockDim.x + threadIdx.x, slot = first + row / lanes;
  const Lane lane{static_cast<int>(threadIdx.x % lanes), lanes};
  typename Pass::Sum sum;
  const bool is_mine = row / lanes < count;
  if (is_mine) sum = pass.gather(slot, lane);
  if constexpr (lanes > 32) {
    combine_block<lanes>(sum);
  } else if constexpr (lanes > 1) {
#pragma unroll
    for (int distance = lanes / 2; distance > 0; distance /= 2) sum.combine(of_lane(sum, distance));
  }
  if (is_mine && lane.index == 0) pass.finish(slot, sum);
}
#endif

}  // namespace fastcollide
