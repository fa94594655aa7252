// Adds to a shared integer and returns what it was. Integers: the order of the additions changes no sum.
#pragma once

#include "../math.hpp"

namespace fastcollide::search {

FC_HOST_DEVICE inline std::int64_t atomic_add(std::int64_t* target, std::int64_t value) {
#if defined(__CUDA_ARCH__)
  return static_cast<std::int64_t>(
      atomicAdd(reinterpret_cast<unsigned long long*>(target), static_cast<unsigned long long>(value)));
#elif !defined(__CUDACC__)
  return std::atomic_ref<std::int64_t>(*target).fetch_add(value, std::memory_order_relaxed);
#else
  const std::int64_t before = *target;  // host pass of nvcc: compiled, never run
  *target += value;
  return before;
#endif
}

}  // namespace fastcollide::search
