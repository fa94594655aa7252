// Runs all stages of many frames in one kernel: every thread of the GPU follows the same page of code, and the whole
// grid waits at the end of each stage. No launch, and no word to the host, comes between two stages.
#pragma once

#include <cooperative_groups.h>

#include <cstdint>
#include <cub/block/block_reduce.cuh>
#include <cub/block/block_scan.cuh>
#include <type_traits>

#include "../stage_timer.hpp"
#include "lanes.cuh"

namespace fastcollide {

inline constexpr int grid_run_threads = 256;

// `lanes` threads of a warp share one sphere in for_each_sphere.
template <int lanes>
class GridRun {
 public:
  // block_totals: one word for each block; ticks: of each stage, or null.
  FC_HOST_DEVICE GridRun(std::uint32_t* block_totals, std::uint64_t* ticks)
      : block_totals_(block_totals), ticks_(ticks) {
#if defined(__CUDA_ARCH__)
    last_ = clock64();
#endif
  }

  template <class F>
  FC_HOST_DEVICE void for_each(Stage stage, std::int64_t n, const F& f) {
#if defined(__CUDA_ARCH__)
    for (std::int64_t i = first_thread(); i < n; i += all_threads()) f(i);
    wait(stage);
#endif
  }

  template <class Pass>
  FC_HOST_DEVICE void for_each_sphere(Stage stage, std::int64_t n, const Pass& pass) {
#if defined(__CUDA_ARCH__)
    const Lane lane{static_cast<int>(threadIdx.x % lanes), lanes};
    // Whole warps, so that all lanes of a sphere are there to add up.
    const std::int64_t rows = (n * lanes + 31) / 32 * 32;
    for (std::int64_t row = first_thread(); row < rows; row += all_threads()) {
      const std::int64_t slot = row / lanes;
      typename Pass::Sum sum;
      if (slot < n) sum = pass.gather(slot, lane);
      if (__any_sync(0xFFFFFFFFu, !sum.is_empty())) {
        for (int distance = lanes / 2; distance > 0; distance /= 2) sum.combine(of_lane(sum, distance));
      }
      if (slot < n && lane.index == 0) pass.finish(slot, sum);
    }
    wait(stage);
#endif
  }

  template <class F>
  FC_HOST_DEVICE void alone(const F& f) {
#if defined(__CUDA_ARCH__)
    if (first_thread() == 0) f(0);
#endif
  }

  // Writes the sum of the counts before each one, n + 1 in all, and leaves the counts at zero.
  FC_HOST_DEVICE void exclusive_scan(Stage stage, std::uint32_t* counts, std::uint32_t* sums, std::int64_t n) {
#if defined(__CUDA_ARCH__)
    using Reduce = cub::BlockReduce<std::uint32_t, grid_run_threads>;
    using Scan = cub::BlockScan<std::uint32_t, grid_run_threads>;
    __shared__ union {
      typename Reduce::TempStorage reduce;
      typename Scan::TempStorage scan;
    } shared;
    __shared__ std::uint32_t before;
    const std::int64_t blocks = gridDim.x, block = blockIdx.x;
    const std::int64_t begin = n * block / blocks, end = n * (block + 1) / blocks;
    std::uint32_t sum = 0;
    for (std::int64_t i = begin + threadIdx.x; i < end; i += blockDim.x) sum += counts[i];
    sum = Reduce(shared.reduce).Sum(sum);
    if (threadIdx.x == 0) block_totals_[block] = sum;
    wait(stage);
    sum = 0;
    for (std::int64_t i = threadIdx.x; i < block; i += blockDim.x) sum += block_totals_[i];
    sum = Reduce(shared.reduce).Sum(sum);
    if (threadIdx.x == 0) before = sum;
    __syncthreads();
    sum = before;
    for (std::int64_t tile = begin; tile < end; tile += blockDim.x) {
      const std::int64_t i = tile + threadIdx.x;
      const std::uint32_t count = i < end ? counts[i] : 0;
      std::uint32_t place, total;
      Scan(shared.scan).ExclusiveSum(count, place, total);
      if (i < end) {
        sums[i] = sum + place;
        counts[i] = 0;
      }
      sum += total;
      __syncthreads();
    }
    if (block == blocks - 1 && threadIdx.x == 0) sums[n] = sum;
    wait(stage);
#endif
  }

  template <class T>
  FC_HOST_DEVICE T read(const T* word) const {
    using Word = std::conditional_t<sizeof(T) == 8, std::uint64_t, std::uint32_t>;
    static_assert(sizeof(T) == sizeof(Word));
    const Word found = *reinterpret_cast<const volatile Word*>(word);
    T value;
    memcpy(&value, &found, sizeof value);
    return value;
  }

 private:
#if defined(__CUDA_ARCH__)
  __device__ static std::int64_t first_thread() { return std::int64_t(blockIdx.x) * blockDim.x + threadIdx.x; }
  __device__ static std::int64_t all_threads() { return std::int64_t(gridDim.x) * blockDim.x; }
  __device__ void wait(Stage stage) {
    cooperative_groups::this_grid().sync();
    if (ticks_ == nullptr || first_thread() != 0) return;
    const long long now = clock64();
    ticks_[static_cast<int>(stage)] += static_cast<std::uint64_t>(now - last_);
    last_ = now;
  }
#endif

  std::uint32_t* block_totals_;
  std::uint64_t* ticks_;
  long long last_ = 0;
};

// Two blocks of 256 fit on a multiprocessor of any card with up to 128 registers for each thread.
template <int lanes, class Program>
__global__ void __launch_bounds__(grid_run_threads, 2)
    run_on_grid(const __grid_constant__ Program program, std::uint32_t* block_totals, std::uint64_t* ticks) {
  GridRun<lanes> run(block_totals, ticks);
  program(run);
}

}  // namespace fastcollide
