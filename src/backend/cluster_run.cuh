// Runs all frames of a call on a cluster of blocks that write into each other's shared memory: no launch, and no word
// through the memory of the device, comes between two stages. For cards of compute capability 9.0 and above.
#pragma once

#include <cooperative_groups.h>

#include <algorithm>
#include <cstdint>
#include <cuda/ptx>

#include "../small_host_run.hpp"
#include "cuda.cuh"
#include "lanes.cuh"

namespace fastcollide {

inline constexpr int cluster_run_threads = 512;

#if defined(__CUDA_ARCH__) && defined(_CG_HAS_CLUSTER_GROUP)
class ClusterRun {
 public:
  // owned: spheres of a block, the last ones may have fewer or none; lanes: that share one of them, a power of two up
  // to 32; arrived: two barriers in shared memory.
  __device__ ClusterRun(std::uint32_t count, std::uint32_t owned, std::uint32_t lanes, std::uint64_t* arrived,
                        std::uint64_t* ticks)
      : lanes_(lanes), arrived_(arrived), ticks_(ticks), last_(clock64()) {
    const auto cluster = cooperative_groups::this_cluster();
    block_ = cluster.block_rank();
    blocks_ = cluster.num_blocks();
    first_ = min(block_ * owned, count);
    owned_ = min(owned, count - first_);
    others_ = count - owned_;
    if (threadIdx.x == 0) {
      cuda::ptx::mbarrier_init(arrived, 1);
      cuda::ptx::mbarrier_init(arrived + 1, 1);
      cuda::ptx::fence_mbarrier_init(cuda::ptx::sem_release, cuda::ptx::scope_cluster);
    }
    cluster.sync();
  }
  __device__ std::uint32_t first() const { return first_; }
  __device__ std::uint32_t owned() const { return owned_; }
  __device__ std::uint32_t block() const { return block_; }
  __device__ std::uint32_t blocks() const { return blocks_; }

  // Every block for all slots, in its own memory.
  template <class F>
  __device__ void for_all(Stage stage, std::uint32_t n, const F& f) {
    for (std::uint32_t i = threadIdx.x; i < n; i += blockDim.x) f(i);
    wait_for_block(stage);
  }
  // For the slots of this block, in its own memory.
  template <class F>
  __device__ void for_own(Stage stage, const F& f) {
    for (std::uint32_t i = threadIdx.x; i < owned_; i += blockDim.x) f(first_ + i);
    wait_for_block(stage);
  }
  template <class F>
  __device__ void for_own_shared(Stage stage, const F& f) {
    for (std::uint32_t row = threadIdx.x; row < owned_ * lanes_; row += blockDim.x) {
      f(first_ + row / lanes_, Lane{static_cast<int>(row % lanes_), static_cast<int>(lanes_)});
    }
    wait_for_block(stage);
  }

  // For the slots of this block; what f has written is sent to the others. Ends when what they send is there.
  template <class F, class Send>
  __device__ void for_each(Stage stage, const F& f, const Send& send) {
    for (std::uint32_t i = threadIdx.x; i < owned_; i += blockDim.x) f(first_ + i);
    exchange(stage, send);
  }
  template <class Pass, class Send>
  __device__ void for_each_sphere(Stage stage, const Pass& pass, const Send& send) {
    // Whole warps, so that all lanes of a sphere are there to add up.
    const std::uint32_t rows = owned_ * lanes_;
    for (std::uint32_t row = threadIdx.x; row < (rows + 31) / 32 * 32; row += blockDim.x) {
      const std::uint32_t slot = first_ + row / lanes_;
      const Lane lane{static_cast<int>(row % lanes_), static_cast<int>(lanes_)};
      typename Pass::Sum sum;
      if (row < rows) sum = pass.gather(slot, lane);
      if (__any_sync(0xFFFFFFFFu, !sum.is_empty())) {
        for (int distance = lane.count / 2; distance > 0; distance /= 2) sum.combine(of_lane(sum, distance));
      }
      if (row < rows && lane.index == 0) pass.finish(slot, sum);
    }
    exchange(stage, send);
  }

  // In each block; the others wait at the end of the stage that follows.
  template <class F>
  __device__ void alone(const F& f) {
    if (threadIdx.x == 0) f();
  }
  __device__ bool any_is_stale(const SmallNews* news) const {
    const std::uint32_t lane = threadIdx.x % 32;
    return __any_sync(0xFFFFFFFFu, lane < blocks_ && news[lane].is_stale != 0);
  }
  // What blocks have written to the memory of the device is there for all.
  __device__ void wait_for_memory() { cooperative_groups::this_cluster().sync(); }
  __device__ std::uint64_t read(const std::uint64_t* word) const {
    return *static_cast<const volatile std::uint64_t*>(word);
  }

 private:
  // Bytes of some spheres, in the sixteens that are sent at once; lay_out() has room for them.
  template <class T>
  __device__ static std::uint32_t bytes_of(std::uint32_t spheres) {
    return (spheres * static_cast<std::uint32_t>(sizeof(T)) + 15) / 16 * 16;
  }

  struct Count {
    const ClusterRun& run;
    std::uint32_t& bytes;
    // A block begins at a multiple of 4 spheres: no sixteen belongs to two of them.
    template <class T>
    __device__ void operator()(T*) const {
      bytes += bytes_of<T>(run.others_);
    }
    __device__ void news(SmallNews*) const {
      bytes += (run.blocks_ - 1) * static_cast<std::uint32_t>(sizeof(SmallNews));
    }
  };
  struct ToBlock {
    const ClusterRun& run;
    std::uint32_t block;
    std::uint64_t* arrived;
    template <class T>
    __device__ void operator()(T* array) const {
      copy(array + run.first_, bytes_of<T>(run.owned_));
    }
    __device__ void news(SmallNews* all) const { copy(all + run.block_, sizeof(SmallNews)); }
    template <class T>
    __device__ void copy(T* from, std::uint32_t bytes) const {
      if (bytes == 0) return;
      const auto cluster = cooperative_groups::this_cluster();
      cuda::ptx::cp_async_bulk(cuda::ptx::space_cluster, cuda::ptx::space_shared, cluster.map_shared_rank(from, block),
                               from, bytes, cluster.map_shared_rank(arrived, block));
    }
  };

  // A block has all that the others wrote in this stage when so many bytes have arrived. It is in no need of a barrier:
  // what a block reads in a stage is overwritten by the stage after the next, and nobody begins that before it has got
  // what this block has written in the next.
  template <class Send>
  __device__ void exchange(Stage stage, const Send& send) {
    cuda::ptx::fence_proxy_async(cuda::ptx::space_shared);
    __syncthreads();
    std::uint64_t* arrived = arrived_ + exchanges_ % 2;
    if (threadIdx.x == 0) {
      std::uint32_t bytes = 0;
      send(Count{*this, bytes});
      cuda::ptx::mbarrier_arrive_expect_tx(cuda::ptx::sem_release, cuda::ptx::scope_cta, cuda::ptx::space_shared,
                                           arrived, bytes);
    }
    // One warp for each of the other blocks.
    for (std::uint32_t block = threadIdx.x / 32; block < blocks_; block += blockDim.x / 32) {
      if (threadIdx.x % 32 == 0 && block != block_) send(ToBlock{*this, block, arrived});
    }
    while (!cuda::ptx::mbarrier_try_wait_parity(arrived, exchanges_ / 2 % 2)) {
    }
    ++exchanges_;
    count_ticks(stage);
  }

  __device__ void wait_for_block(Stage stage) {
    __syncthreads();
    count_ticks(stage);
  }
  __device__ void count_ticks(Stage stage) {
    if (ticks_ == nullptr || blockIdx.x > 0 || threadIdx.x > 0) return;
    const long long now = clock64();
    ticks_[static_cast<int>(stage)] += static_cast<std::uint64_t>(now - last_);
    last_ = now;
  }

  std::uint32_t block_, blocks_, first_, owned_, others_, lanes_, exchanges_ = 0;
  std::uint64_t* arrived_;
  std::uint64_t* ticks_;
  long long last_;
};
#endif

// `program` is a struct with `void operator()(Run&, unsigned char* memory, std::uint32_t owned) const`.
template <class Program>
__global__ void __launch_bounds__(cluster_run_threads, 1)
    run_on_cluster(const __grid_constant__ Program program, std::uint32_t count, std::uint32_t owned,
                   std::uint32_t lanes, std::uint64_t* ticks) {
#if defined(__CUDA_ARCH__) && defined(_CG_HAS_CLUSTER_GROUP)
  extern __shared__ __align__(16) unsigned char block_memory[];
  __shared__ std::uint64_t arrived[2];
  ClusterRun run(count, owned, lanes, arrived, ticks);
  program(run, block_memory, owned);
#endif
}

// Asks only whether such a cluster can be started.
inline __global__ void __launch_bounds__(cluster_run_threads, 1) probe_cluster() {}

template <>
struct SmallRunner<CudaBackend> {
  explicit SmallRunner(CudaBackend& backend) : backend(backend) {
    const OnDevice on(backend.cuda_device());
    const auto attribute = [&](cudaDeviceAttr which) {
      int value = 0;
      check(cudaDeviceGetAttribute(&value, which, backend.cuda_device()), "cudaDeviceGetAttribute");
      return value;
    };
    if (attribute(cudaDevAttrComputeCapabilityMajor) < 9) return;
    block_bytes = static_cast<std::size_t>(attribute(cudaDevAttrMaxSharedMemoryPerBlockOptin)) - 64;  // for barriers
    for (most_blocks = 16; most_blocks >= 4 && !can_start(probe_cluster, most_blocks); most_blocks /= 2) {
    }
  }

  bool has_room(SmallWorld world) const {
    return most_blocks >= 4 &&
           world.lay_out(nullptr, owned_by_block(world.count, most_blocks), most_blocks) <= block_bytes;
  }
  // With more spheres, what blocks send each other takes too long.
  bool pays(std::int64_t count) const { return count <= 1280; }

  template <class Program>
  void run(const Program& program, StageTimer& timer) {
    const OnDevice on(backend.cuda_device());
    SmallWorld world = program.world;
    // A power of two; fewer blocks wait for each other sooner.
    std::uint32_t blocks = 1;
    while (blocks < most_blocks && blocks * enough_owned < world.count) blocks *= 2;
    const std::uint32_t owned = owned_by_block(world.count, blocks);
    std::uint32_t lanes = most_lanes;
    while (lanes > 1 && owned * lanes > cluster_run_threads) lanes /= 2;
    const std::uint32_t threads = std::min<std::uint32_t>((owned * lanes + 31) / 32 * 32, cluster_run_threads);
    const auto kernel = run_on_cluster<Program>;
    allow_large(kernel);
    cudaLaunchAttribute cluster;
    const cudaLaunchConfig_t config = configure(cluster, blocks, threads, world.lay_out(nullptr, owned, blocks));
    backend.time_ticks(timer, [&](std::uint64_t* ticks) {
      check(cudaLaunchKernelEx(&config, kernel, program, world.count, owned, lanes, ticks), "cluster launch");
    });
  }

 private:
  static constexpr std::uint32_t enough_owned = 32, most_lanes = 8;
  static std::uint32_t owned_by_block(std::uint32_t count, std::uint32_t blocks) {
    return (count + 4 * blocks - 1) / (4 * blocks) * 4;
  }

  template <class Kernel>
  void allow_large(Kernel kernel) const {
    check(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, static_cast<int>(block_bytes)),
          "shared memory");
    check(cudaFuncSetAttribute(kernel, cudaFuncAttributeNonPortableClusterSizeAllowed, 1), "cluster size");
  }
  cudaLaunchConfig_t configure(cudaLaunchAttribute& cluster, std::uint32_t blocks, std::uint32_t threads,
                               std::size_t bytes) const {
    cluster = {};
    cluster.id = cudaLaunchAttributeClusterDimension;
    cluster.val.clusterDim = {blocks, 1, 1};
    cudaLaunchConfig_t config{};
    config.gridDim = {blocks, 1, 1};
    config.blockDim = {threads, 1, 1};
    config.dynamicSmemBytes = bytes;
    config.stream = backend.stream();
    config.attrs = &cluster;
    config.numAttrs = 1;
    return config;
  }
  bool can_start(void (*kernel)(), std::uint32_t blocks) const {
    allow_large(kernel);
    cudaLaunchAttribute cluster;
    const cudaLaunchConfig_t config = configure(cluster, blocks, cluster_run_threads, block_bytes);
    int clusters = 0;
    const cudaError_t status = cudaOccupancyMaxActiveClusters(&clusters, kernel, &config);
    if (status != cudaSuccess) cudaGetLastError();  // more blocks than a cluster of this card may have
    return status == cudaSuccess && clusters > 0;
  }

  CudaBackend& backend;
  std::uint32_t most_blocks = 0;  // of a cluster; 0: there are none
  std::size_t block_bytes = 0;
};

}  // namespace fastcollide
