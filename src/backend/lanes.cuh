// What lanes of a warp have gathered, passed on.
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
#endif

}  // namespace fastcollide
