// The backend on one NVIDIA GPU: everything runs in order on a stream of its own.
#pragma once

#include <cuda_runtime.h>
#include <thrust/iterator/counting_iterator.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_reduce.cuh>
#include <cub/device/device_scan.cuh>
#include <memory>
#include <numeric>
#include <string>
#include <type_traits>

#include "../math.hpp"
#include "concept.hpp"
#include "fastcollide/errors.hpp"
#include "grid_run.cuh"
#include "group_run.cuh"

namespace fastcollide {

inline void check(cudaError_t status, const char* what) {
  if (status == cudaSuccess) return;
  cudaGetLastError();  // an error that is not sticky must not surface in someone else's call
  throw DeviceError(std::string(what) + ": " + cudaGetErrorString(status));
}

// The calling thread's current device belongs to the host program: it is put back.
class OnDevice {
 public:
  explicit OnDevice(int device) {
    check(cudaGetDevice(&before_), "cudaGetDevice");
    if (before_ != device) check(cudaSetDevice(device), "cudaSetDevice");
  }
  ~OnDevice() { cudaSetDevice(before_); }
  OnDevice(const OnDevice&) = delete;
  OnDevice& operator=(const OnDevice&) = delete;

 private:
  int before_ = 0;
};

inline std::shared_ptr<void> allocate_on_device(int device, std::size_t bytes) {
  const OnDevice on(device);
  void* memory = nullptr;
  const cudaError_t status = cudaMalloc(&memory, std::max<std::size_t>(bytes, 1));
  if (status == cudaErrorMemoryAllocation) {
    cudaGetLastError();
    std::size_t free = 0, total = 0;
    cudaMemGetInfo(&free, &total);
    throw OutOfMemory("out of memory on cuda:" + std::to_string(device) + ": " + std::to_string(bytes) +
                      " bytes more are needed, " + std::to_string(free) + " of " + std::to_string(total) + " are free");
  }
  check(status, "cudaMalloc");
  return {memory, [](void* p) { cudaFree(p); }};
}

// The bound lets any stage be launched at any size of block that a world may ask for.
template <class F>
__global__ void __launch_bounds__(512) run_for_each(std::int64_t n, const __grid_constant__ F f) {
  const std::int64_t i = std::int64_t(blockIdx.x) * blockDim.x + threadIdx.x;
  if (i < n) f(i);
}

class CudaBackend {
 public:
  template <class T>
  class Buffer {
    static_assert(std::is_trivially_copyable_v<T>);

   public:
    explicit Buffer(CudaBackend& backend) : device_(backend.device_), stream_(backend.stream_) {}
    Buffer(Buffer&&) noexcept = default;
    Buffer& operator=(Buffer&&) noexcept = default;
    T* data() { return static_cast<T*>(memory_.get()); }
    const T* data() const { return static_cast<const T*>(memory_.get()); }
    std::int64_t size() const { return size_; }
    std::shared_ptr<void> share() const { return memory_; }

    void resize(std::int64_t count) {
      if (count > capacity_) {
        // A first size is exact: a hundred million spheres must fit.
        const std::int64_t capacity = capacity_ == 0 ? count : std::max(count, capacity_ + capacity_ / 2);
        std::shared_ptr<void> memory = allocate_on_device(device_, static_cast<std::size_t>(capacity) * sizeof(T));
        if (size_ > 0) {
          check(cudaMemcpyAsync(memory.get(), memory_.get(), static_cast<std::size_t>(size_) * sizeof(T),
                                cudaMemcpyDeviceToDevice, stream_.get()),
                "cudaMemcpyAsync");
          check(cudaStreamSynchronize(stream_.get()), "cudaStreamSynchronize");
        }
        memory_ = std::move(memory);
        capacity_ = capacity;
      }
      size_ = count;
    }

   private:
    int device_;
    std::shared_ptr<CUstream_st> stream_;
    std::shared_ptr<void> memory_;
    std::int64_t size_ = 0, capacity_ = 0;
  };

  static constexpr std::int64_t frames_between_checks = 16;
  static constexpr std::uint32_t list_width = 32;
  static constexpr bool has_whole_grid = true;

  explicit CudaBackend(int device, int block_size = 128) : device_(device), block_size_(block_size) {
    const OnDevice on(device_);
    cudaStream_t stream = nullptr;
    check(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking), "cudaStreamCreate");
    stream_.reset(stream, [](cudaStream_t s) { cudaStreamDestroy(s); });
    void* words = nullptr;
    check(cudaHostAlloc(&words, most_host_bytes, cudaHostAllocMapped | cudaHostAllocPortable), "cudaHostAlloc");
    host_words_.reset(words, [](void* p) { cudaFreeHost(p); });
  }

  int cuda_device() const { return device_; }
  cudaStream_t stream() const { return stream_.get(); }
  // Where CUB works; it moves when some call wants more of it.
  const void* scratch() const { return scratch_.get(); }

  template <class F>
  void for_each(std::int64_t n, const F& f) {
    if (n == 0) return;
    const OnDevice on(device_);
    const std::int64_t blocks = (n + block_size_ - 1) / block_size_;
    run_for_each<<<static_cast<unsigned>(blocks), static_cast<unsigned>(block_size_), 0, stream_.get()>>>(n, f);
    check(cudaGetLastError(), "kernel launch");
  }

  template <class Pass>
  void for_each_of_groups(const SlotGroups& groups, const Pass& pass) {
    std::int64_t blocks = 0, sharing = 0;  // of all; as far as some of them share a sphere
    for (int k = 0; k < groups.count; ++k) {
      blocks += blocks_of(groups.groups[k]);
      if (groups.groups[k].lanes > group_run_threads) sharing = blocks;
    }
    if (blocks == 0) return;
    const OnDevice on(device_);
    const SumsOfBlocks sums = sums_of_blocks(sharing, sizeof(typename Pass::Sum));
    run_groups<<<static_cast<unsigned>(blocks), group_run_threads, 0, stream_.get()>>>(groups, sums, pass);
    check(cudaGetLastError(), "kernel launch");
  }

  // Runs a program, a struct with `template <class Run> void operator()(Run&) const`, on the whole GPU in one kernel.
  // n: most elements of a stage; small programs use few blocks, which wait for each other sooner.
  template <int lanes, class Program>
  void run_on_whole_grid(std::int64_t n, const Program& program, StageTimer& timer) {
    const OnDevice on(device_);
    int blocks_each = 0, multiprocessors = 0;
    const auto kernel = run_on_grid<lanes, Program>;
    check(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&blocks_each, kernel, grid_run_threads, 0), "occupancy");
    check(cudaDeviceGetAttribute(&multiprocessors, cudaDevAttrMultiProcessorCount, device_), "multiprocessors");
    const std::int64_t most = std::int64_t(blocks_each) * multiprocessors;
    const std::int64_t blocks =
        std::clamp<std::int64_t>((n * lanes + grid_run_threads - 1) / grid_run_threads, 1, most);
    if (block_totals_ == nullptr) {  // room for any kernel's blocks: no more than 32 fit on a multiprocessor
      block_totals_ = allocate_on_device(device_, std::size_t(multiprocessors) * 32 * sizeof(std::uint32_t));
    }
    std::uint32_t* block_totals = static_cast<std::uint32_t*>(block_totals_.get());
    time_ticks(timer, [&](std::uint64_t* ticks) {
      void* arguments[] = {const_cast<Program*>(&program), &block_totals, &ticks};
      check(cudaLaunchCooperativeKernel(reinterpret_cast<const void*>(kernel), static_cast<unsigned>(blocks),
                                        grid_run_threads, arguments, 0, stream_.get()),
            "cooperative launch");
    });
  }

  // start(ticks) starts a kernel that runs all stages and, where the timer asks, adds up the ticks of each.
  template <class Start>
  void time_ticks(StageTimer& timer, const Start& start) {
    if (!timer.enabled) return start(nullptr);
    if (ticks_ == nullptr) ticks_ = allocate_on_device(device_, stage_names.size() * sizeof(std::uint64_t));
    auto* ticks = static_cast<std::uint64_t*>(ticks_.get());
    fill_zero(ticks, stage_names.size());
    const auto begin = std::chrono::steady_clock::now();
    start(ticks);
    std::array<std::uint64_t, stage_names.size()> shares{};
    copy_to_host(shares.data(), static_cast<const std::uint64_t*>(ticks), shares.size());
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    const auto all = static_cast<double>(std::accumulate(shares.begin(), shares.end(), std::uint64_t(1)));
    for (std::size_t i = 0; i < shares.size(); ++i) {
      timer.add(static_cast<Stage>(i), seconds * static_cast<double>(shares[i]) / all);
    }
  }

  template <class F, class T, class Operation>
  T transform_reduce(std::int64_t n, const F& f, T identity, Operation combine) {
    if (n == 0) return identity;
    static_assert(sizeof(T) <= most_host_bytes);
    const OnDevice on(device_);
    T* result = static_cast<T*>(host_words_.get());  // the device writes it there by itself
    with_scratch("reduce", [&](void* scratch, std::size_t& bytes) {
      return cub::DeviceReduce::TransformReduce(scratch, bytes, thrust::counting_iterator<std::int64_t>(0), result, n,
                                                combine, f, identity, stream_.get());
    });
    check(cudaStreamSynchronize(stream_.get()), "cuda");
    return *result;
  }

  template <class Count>
  void exclusive_scan(Count* counts, std::int64_t n) {
    fill_zero(counts + n, 1);
    exclusive_scan(static_cast<const Count*>(counts), counts, n);
  }
  template <class Count>
  void exclusive_scan(const Count* counts, Count* sums, std::int64_t n) {
    const OnDevice on(device_);
    with_scratch("scan", [&](void* scratch, std::size_t& bytes) {
      return cub::DeviceScan::ExclusiveSum(scratch, bytes, counts, sums, n + 1, stream_.get());
    });
  }

  void sort_pairs(const std::uint32_t* keys_in, std::uint32_t* keys_out, const std::uint32_t* values_in,
                  std::uint32_t* values_out, std::int64_t n, int bits) {
    const OnDevice on(device_);
    with_scratch("sort", [&](void* scratch, std::size_t& bytes) {
      return cub::DeviceRadixSort::SortPairs(scratch, bytes, keys_in, keys_out, values_in, values_out, n, 0,
                                             std::max(bits, 1), stream_.get());
    });
  }

  template <class T>
  void fill_zero(T* data, std::int64_t n) {
    if (n == 0) return;
    const OnDevice on(device_);
    check(cudaMemsetAsync(data, 0, static_cast<std::size_t>(n) * sizeof(T), stream_.get()), "cudaMemset");
  }
  template <class T>
  void copy(T* to, const T* from, std::int64_t n) {
    copy(to, from, n, cudaMemcpyDeviceToDevice);
  }
  template <class T>
  void copy_to_device(T* device, const T* host, std::int64_t n) {
    copy(device, host, n, cudaMemcpyHostToDevice);
  }
  template <class T>
  void copy_to_host(T* host, const T* device, std::int64_t n) {
    // Few bytes come sooner by way of memory that the host has pinned.
    const std::size_t bytes = static_cast<std::size_t>(n) * sizeof(T);
    T* target = bytes <= most_host_bytes ? static_cast<T*>(host_words_.get()) : host;
    copy(target, device, n, cudaMemcpyDeviceToHost);
    const OnDevice on(device_);
    check(cudaStreamSynchronize(stream_.get()), "cuda");
    if (target != host) std::copy_n(target, n, host);
  }
  // Waits for the user's work on this device too: it may write to arrays that they share with the world.
  void synchronize() {
    const OnDevice on(device_);
    check(cudaDeviceSynchronize(), "cuda");
  }
  // One stream goes on when what is queued on another is done; the host does not wait. `stream` is a cudaStream_t.
  void wait_for(void* stream) { order(static_cast<cudaStream_t>(stream), stream_.get()); }
  void let_wait(void* stream) { order(stream_.get(), static_cast<cudaStream_t>(stream)); }

 private:
  void order(cudaStream_t before, cudaStream_t after) {
    const OnDevice on(device_);
    cudaEvent_t event = nullptr;
    check(cudaEventCreateWithFlags(&event, cudaEventDisableTiming), "cudaEventCreate");
    cudaError_t status = cudaEventRecord(event, before);
    if (status == cudaSuccess) status = cudaStreamWaitEvent(after, event);
    cudaEventDestroy(event);  // at once if the device has passed it, else when it has
    check(status, "cudaStreamWaitEvent");
  }

  SumsOfBlocks sums_of_blocks(std::int64_t blocks, std::size_t bytes_each) {
    const std::size_t bytes = static_cast<std::size_t>(blocks) * bytes_each;
    if (blocks > arrived_size_ || bytes > block_sums_bytes_) {
      synchronize();
      arrived_size_ = 0;  // nothing is there should memory run out on the way
      arrived_ = allocate_on_device(device_, static_cast<std::size_t>(blocks) * sizeof(std::uint32_t));
      block_sums_ = allocate_on_device(device_, bytes);
      fill_zero(static_cast<std::uint32_t*>(arrived_.get()), blocks);
      arrived_size_ = blocks;
      block_sums_bytes_ = bytes;
    }
    return {static_cast<unsigned char*>(block_sums_.get()), static_cast<std::uint32_t*>(arrived_.get())};
  }

  template <class T>
  void copy(T* to, const T* from, std::int64_t n, cudaMemcpyKind kind) {
    if (n == 0) return;
    const OnDevice on(device_);
    check(cudaMemcpyAsync(to, from, static_cast<std::size_t>(n) * sizeof(T), kind, stream_.get()), "cudaMemcpy");
  }

  // CUB asks how much scratch it wants, then works. The scratch is kept: a frame allocates nothing.
  template <class Call>
  void with_scratch(const char* what, const Call& call) {
    std::size_t bytes = 0;
    check(call(nullptr, bytes), what);
    bytes = std::max<std::size_t>(bytes, 1);
    if (bytes > scratch_bytes_) {
      synchronize();
      scratch_ = allocate_on_device(device_, bytes);
      scratch_bytes_ = bytes;
    }
    check(call(scratch_.get(), bytes), what);
  }

  static constexpr std::size_t most_host_bytes = 4096;

  int device_, block_size_;
  std::shared_ptr<CUstream_st> stream_;
  std::shared_ptr<void> host_words_;    // for what the host asks of the device
  std::shared_ptr<void> block_totals_;  // of a program on the whole grid
  std::shared_ptr<void> ticks_;
  std::shared_ptr<void> block_sums_, arrived_;  // of blocks that share a sphere
  std::int64_t arrived_size_ = 0;
  std::size_t block_sums_bytes_ = 0;
  std::shared_ptr<void> scratch_;
  std::size_t scratch_bytes_ = 0;
};

}  // namespace fastcollide
