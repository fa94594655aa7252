// Starts the stages of frames as kernels on a stream, and many frames at once as a CUDA graph of them.
#pragma once

#include <algorithm>
#include <cstring>
#include <cub/block/block_load.cuh>
#include <cub/block/block_scan.cuh>
#include <cub/block/block_store.cuh>
#include <type_traits>
#include <utility>
#include <vector>

#include "../host_run.hpp"
#include "../stage_timer.hpp"
#include "cuda.cuh"
#include "lanes.cuh"
#include "shared_pairs.cuh"

namespace fastcollide {

inline constexpr int graph_run_threads = 128;

// A stage may be put on the device before the one it follows has ended, so that its launch takes no time of its own;
// it waits here. Cards before compute capability 9.0 start it when the other has ended.
__device__ inline void wait_for_stage_before() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  cudaGridDependencySynchronize();
  cudaTriggerProgrammaticLaunchCompletion();
#endif
}

template <class F>
__global__ void __launch_bounds__(graph_run_threads) run_stage(std::int64_t n, const __grid_constant__ F f) {
  wait_for_stage_before();
  const std::int64_t i = std::int64_t(blockIdx.x) * blockDim.x + threadIdx.x;
  if (i < n) f(i);
}

inline constexpr std::uint32_t near_of_lane = 2;  // that it finds before they are worked on

// What a warp looks at that shares a sphere of which it is not known who is near. Its lanes look through the list and
// the grid, and work side by side on those whom they find.
template <class Base>
struct WarpNeighbors : Base {
  std::uint32_t* near;   // in shared memory, of this warp
  std::uint32_t* found;  // likewise: how many

  __device__ WarpNeighbors(const Base& base, std::uint32_t* near, std::uint32_t* found)
      : Base(base), near(near), found(found) {}

  template <class Grid, class Visit>
  FC_HOST_DEVICE void visit(const Grid& grid, std::int64_t slot, Vec3, Lane lane, Visit& visit) const {
#if defined(__CUDA_ARCH__)
    // As many rounds as the lane with the most of them needs.
    bool has_more = true;
    for (std::uint32_t round = 0; __any_sync(0xFFFFFFFFu, has_more); ++round) {
      if (lane.index == 0) *found = 0;
      __syncwarp();
      std::uint32_t own = 0;
      auto keep = [&](std::uint32_t other) {
        if (own++ / near_of_lane == round) near[atomicAdd(found, 1)] = other;
      };
      Base::visit_shared(grid, slot, grid.position_radius[slot], lane, keep);
      has_more = own > (round + 1) * near_of_lane;
      __syncwarp();
      const std::uint32_t count = *found;
      for (auto k = static_cast<std::uint32_t>(lane.index); k < count; k += 32) visit(near[k]);
      __syncwarp();
    }
#endif
  }
};

inline constexpr int graph_run_warps = graph_run_threads / 32;

struct SharedByWarps {
  std::uint32_t near[graph_run_warps][32 * near_of_lane], found[graph_run_warps];
};

// Called by a whole warp.
template <class Pass>
__device__ void run_by_warp(const Pass& pass, std::int64_t slot, SharedByWarps& shared) {
  const Lane lane{static_cast<int>(threadIdx.x % 32), 32};
  const auto here = pass.at(slot);
  const auto warp = threadIdx.x / 32;
  const auto sharing = here.with_neighbors(
      WarpNeighbors<typename Pass::ListNeighbors>(here.neighbors, shared.near[warp], &shared.found[warp]));
  const auto self = sharing.load(slot);
  auto sum = sharing.gather(self, slot, lane);
#pragma unroll
  for (int distance = 16; distance > 0; distance /= 2) sum.combine(of_lane(sum, distance));
  if (lane.index == 0) sharing.finish(self, slot, sum);
}

// `lanes` threads of a warp share one sphere. 72 registers, or 80 where few spheres leave room on the device: more
// threads wait for memory at the same time. A rough pass gets 128, as it would keep too much in memory with fewer.
// The first blocks help strays. shares: the pairs of a warp, see shared_pairs.cuh.
template <int lanes, bool shares, class Pass>
__global__ void __launch_bounds__(graph_run_threads, Pass::has_friction ? 4
                                                     : lanes == 8       ? 6
                                                                        : 7)
    run_shared_pass(std::int64_t count, std::uint32_t helping_blocks, const __grid_constant__ Pass pass) {
  constexpr bool gets_help = Pass::gets_help && lanes < 8;
  wait_for_stage_before();
  if constexpr (gets_help) {
    __shared__ SharedByWarps shared;
    if (blockIdx.x < helping_blocks) {
      const std::uint32_t helped = pass.helped_in(blockIdx.x * graph_run_warps + threadIdx.x / 32);
      if (helped != no_slot) run_by_warp(pass, helped, shared);
      return;
    }
  }
  const std::int64_t row = std::int64_t(blockIdx.x - helping_blocks) * blockDim.x + threadIdx.x, slot = row / lanes;
  const Lane lane{static_cast<int>(threadIdx.x % lanes), lanes};
  const bool is_in_range = slot < count;
  // What a sphere itself needs is asked for at once.
  const auto here = pass.at(is_in_range ? slot : 0);
  const auto self = here.load(is_in_range ? slot : 0);
  const bool is_mine = is_in_range && !(gets_help && pass.is_helped(slot));
  typename Pass::Sum sum;
  if constexpr (shares) {
    __shared__ PairsOfWarp<typename Pass::Sum, places_for_pairs> pairs[graph_run_warps];
    sum = gather_by_pairs<lanes>(pass, here, pairs[threadIdx.x / 32], self, slot, is_mine);
  } else {
    if (is_mine) sum = here.gather(self, slot, lane);
    if constexpr (lanes > 1) {
      if (__any_sync(0xFFFFFFFFu, !sum.is_empty())) {
#pragma unroll
        for (int distance = lanes / 2; distance > 0; distance /= 2) sum.combine(of_lane(sum, distance));
      }
    }
  }
  if (is_mine && lane.index == 0) here.finish(self, slot, sum);
}

// Writes records of the spheres for whom find() is true, those of a block one after the other: from the first place on,
// or from the last one down where it is not known who is near.
template <class Find, class Record>
__global__ void __launch_bounds__(graph_run_threads)
    write_records(std::int64_t n, Record* records, const __grid_constant__ Find find) {
  constexpr int warps = graph_run_threads / 32;
  __shared__ std::uint32_t near[Record::places][graph_run_threads], found[warps][2], first[2];
  wait_for_stage_before();
  const std::int64_t slot = std::int64_t(blockIdx.x) * blockDim.x + threadIdx.x;
  const int warp = static_cast<int>(threadIdx.x / 32);
  std::uint32_t count = 0;
  const auto place = [&](std::uint32_t k) -> std::uint32_t& { return near[k][threadIdx.x]; };
  const bool has_record = slot < n && find(slot, count, place);
  const int kind = count == Record::unknown ? 1 : 0;
  const std::uint32_t masks[2] = {__ballot_sync(0xFFFFFFFFu, has_record && kind == 0),
                                  __ballot_sync(0xFFFFFFFFu, has_record && kind == 1)};
  if (threadIdx.x % 32 < 2) found[warp][threadIdx.x % 32] = static_cast<std::uint32_t>(__popc(masks[threadIdx.x % 32]));
  __syncthreads();
  if (threadIdx.x < 2) {
    std::uint32_t all = 0;
    for (int i = 0; i < warps; ++i) all += found[i][threadIdx.x];
    if (all > 0) first[threadIdx.x] = atomicAdd(find.record_counts() + threadIdx.x, all);
  }
  __syncthreads();
  if (!has_record) return;
  std::uint32_t before = first[kind] + static_cast<std::uint32_t>(__popc(masks[kind] & ((1u << threadIdx.x % 32) - 1)));
  for (int i = 0; i < warp; ++i) before += found[i][kind];
  Record record;
  record.slot = static_cast<std::uint32_t>(slot);
  record.count = count;
#pragma unroll
  for (std::uint32_t k = 0; k < Record::places; ++k) record.near[k] = place(k);  // of which some are not used
  records[kind == 0 ? before : n - 1 - before] = record;
}

// A warp shares a sphere of which it is not known who is near: to search takes long, and few have to.
template <class Pass>
__global__ void __launch_bounds__(graph_run_threads, Pass::has_friction ? 4 : 5)
    run_pass_with_records(std::int64_t n, const std::uint32_t* counts, const __grid_constant__ Pass pass) {
  using Pairs = PairsOfWarp<typename Pass::Sum, Pass::places>;
  __shared__ union {
    SharedByWarps found;
    std::conditional_t<can_share_pairs<Pass>, Pairs, std::uint32_t> pairs[graph_run_warps];
  } shared;
  wait_for_stage_before();
  const std::uint32_t thread = blockIdx.x * blockDim.x + threadIdx.x, threads = gridDim.x * blockDim.x;
  const std::uint32_t known = counts[0], unknown = counts[1], warp = thread / 32, warps = threads / 32;
  if constexpr (can_share_pairs<Pass>) {
    auto& pairs = shared.pairs[threadIdx.x / 32];
    const std::uint32_t lane = threadIdx.x % 32;
    for (std::uint32_t first = warp * 32; first < known; first += warps * 32) {
      const bool is_mine = first + lane < known;
      const auto& record = pass.records[is_mine ? first + lane : first];
      const std::uint32_t own = is_mine ? record.count : 0;
      for (std::uint32_t k = 0; k < own; ++k) pairs.near[k][lane] = record.near[k];
      const auto here = pass.at(record.slot);
      const auto self = here.load(record.slot);
      auto sum = here.nothing_yet();
      add_pairs<1>(pass, pairs, record.slot, own, sum);
      if (is_mine) {
        here.add_walls(self, record.slot, sum);
        here.finish(self, record.slot, sum);
      }
    }
    __syncthreads();
  } else {
    for (std::uint32_t i = thread; i < known; i += threads) pass(i);
  }
  // The first of these by the warps after those that had one of the others.
  const std::uint32_t busy = (known + 31) / 32 % warps;
  for (std::uint32_t i = (warp + warps - busy) % warps; i < unknown; i += warps) {
    run_by_warp(pass, pass.records[n - 1 - i].slot, shared.found);
    __syncwarp();
  }
}

// Cells get their slots in blocks of whole rows, in the order in which the blocks come: a row of cells must be one run
// of slots, and nothing else is asked of the order.
inline constexpr int cell_block_threads = 256, cells_of_thread = 4,
                     cells_of_block = cell_block_threads * cells_of_thread;

inline __global__ void __launch_bounds__(cell_block_threads)
    allocate_cell_block(const std::uint32_t* counts, std::uint32_t* start, std::uint32_t* end, std::int64_t cells,
                        std::int64_t cells_each, std::uint32_t* next_slot) {
  using Load = cub::BlockLoad<std::uint32_t, cell_block_threads, cells_of_thread, cub::BLOCK_LOAD_WARP_TRANSPOSE>;
  using Scan = cub::BlockScan<std::uint32_t, cell_block_threads>;
  using Store = cub::BlockStore<std::uint32_t, cell_block_threads, cells_of_thread, cub::BLOCK_STORE_WARP_TRANSPOSE>;
  __shared__ union {
    typename Load::TempStorage load;
    typename Scan::TempStorage scan;
    typename Store::TempStorage store;
  } shared;
  __shared__ std::uint32_t before;
  wait_for_stage_before();
  const std::int64_t first = blockIdx.x * cells_each;
  const int own = static_cast<int>(min(cells_each, cells - first));
  std::uint32_t count[cells_of_thread], place[cells_of_thread], total;
  Load(shared.load).Load(counts + first, count, own, 0u);
  __syncthreads();
  Scan(shared.scan).ExclusiveSum(count, place, total);
  if (threadIdx.x == 0) before = total == 0 ? 0 : atomicAdd(next_slot, total);
  __syncthreads();
#pragma unroll
  for (int i = 0; i < cells_of_thread; ++i) {
    place[i] += before;
    count[i] += place[i];
  }
  Store(shared.store).Store(start + first, place, own);
  __syncthreads();
  Store(shared.store).Store(end + first, count, own);
}

// Graphs of some frames, as long as their kernels' arguments stay the same.
class FrameGraphs {
 public:
  // Of 1, 2 or 4 with the same lists: an even number of lists, so that the copies of the state are as they were.
  static constexpr std::int64_t frames = 8;

  // Of a world, and of the memory that CUB works in: all that the kernels of its frames are given.
  using Key = std::vector<unsigned char>;
  template <class World>
  static Key key_of(const World& world, const void* scratch) {
    static_assert(std::is_trivially_copyable_v<World>);
    Key key(sizeof world + sizeof scratch);
    std::memcpy(key.data(), &world, sizeof world);
    std::memcpy(key.data() + sizeof world, &scratch, sizeof scratch);
    return key;
  }

  // Of the largest worlds without and with near_records whose stages have been started: all that they need is loaded
  // and allocated. While they are recorded nothing can be.
  std::int64_t most_cells[2] = {-1, -1};

  // Null where there is none.
  cudaGraphExec_t find(const Key& key) const {
    for (const Entry& entry : entries_) {
      if (entry.key == key) return entry.graph.get();
    }
    return nullptr;
  }
  void keep(Key key, cudaGraphExec_t graph) {
    if (entries_.size() == most) entries_.erase(entries_.begin());
    entries_.push_back({std::move(key), {graph, [](cudaGraphExec_t g) { cudaGraphExecDestroy(g); }}});
  }

 private:
  static constexpr std::size_t most = 4;
  struct Entry {
    Key key;
    std::shared_ptr<CUgraphExec_st> graph;
  };
  std::vector<Entry> entries_;
};

class GraphRun {
 public:
  GraphRun(CudaBackend& backend, StageTimer& timer, FrameGraphs& graphs, std::uint32_t lanes, bool shares_pairs)
      : backend_(backend),
        timer_(timer),
        graphs_(graphs),
        lanes_(lanes),
        shares_pairs_(shares_pairs),
        on_(backend.cuda_device()) {
    int major = 0;
    check(cudaDeviceGetAttribute(&major, cudaDevAttrComputeCapabilityMajor, backend.cuda_device()), "capability");
    can_launch_early_ = major >= 9;
  }

  template <class F>
  void for_each(Stage stage, std::int64_t n, const F& f) {
    timer_.time(backend_, stage, [&] {
      if (n == 0) return;
      launch(run_stage<F>, blocks(n), graph_run_threads, n, f);
    });
  }

  template <class Pass>
  void for_each_sphere(Stage stage, std::int64_t count, const Pass& pass) {
    timer_.time(backend_, stage, [&] {
      switch (lanes_) {
        case 8:
          return start_pass<8, can_share_pairs<Pass>>(count, pass);
        case 4:
          if constexpr (can_share_pairs<Pass>) {
            if (shares_pairs_) return start_pass<4, true>(count, pass);
          }
          return start_pass<4, false>(count, pass);
        default:
          return start_pass<1, can_share_pairs<Pass>>(count, pass);
      }
    });
  }

  template <class Find, class Record, class Pass>
  void for_each_with_record(Stage stage, std::int64_t n, const Find& find, Record* records, const Pass& pass) {
    timer_.time(backend_, stage, [&] {
      launch(write_records<Find, Record>, blocks(n), graph_run_threads, n, records, find);
      // How many there are only the device knows; about as many as are touched, less than a third.
      launch(run_pass_with_records<Pass>, blocks(n / 3 + 1), graph_run_threads, n,
             static_cast<const std::uint32_t*>(find.record_counts()), pass);
    });
  }

  template <class T>
  T read(const T* word) {
    T value;
    backend_.copy_to_host(&value, word, 1);
    return value;
  }

  template <class World>
  void allocate_cells(Stage stage, World& world) {
    timer_.time(backend_, stage, [&] {
      const std::int64_t row = world.shape.x.cells;
      // Of many spheres, those near in space should be near in memory for a whole grid, not for a block of its rows.
      if (row > cells_of_block || lanes_ < 8) {
        backend_.exclusive_scan(static_cast<const std::uint32_t*>(world.cell_counts), world.cell_start, world.cells);
        world.cell_end = world.cell_start + 1;
        return;
      }
      const std::int64_t cells_each = cells_of_block / row * row;
      launch(allocate_cell_block, static_cast<unsigned>((world.cells + cells_each - 1) / cells_each),
             cell_block_threads, world.cell_counts, world.cell_start, world.cell_end, world.cells, cells_each,
             &world.control->next_slot);
    });
  }

  // body() starts the stages of all frames with the same lists and leaves in the world what the next ones need.
  template <class World, class Body>
  void repeat(World& world, std::int64_t times, const Body& body) {
    const std::int64_t each = FrameGraphs::frames / world.frames_of_lists;
    std::int64_t alone = timer_.enabled ? times : times % each;
    std::int64_t& most_cells = graphs_.most_cells[world.near_records != nullptr ? 1 : 0];
    if (world.cells > most_cells) alone = std::min(times, alone + each);
    for (std::int64_t i = 0; i < alone; ++i) body();
    most_cells = std::max(most_cells, world.cells);
    if (alone == times) return;
    const FrameGraphs::Key key = FrameGraphs::key_of(world, backend_.scratch());
    if (graphs_.find(key) == nullptr) graphs_.keep(key, record(each, body));
    cudaGraphExec_t graph = graphs_.find(key);
    for (std::int64_t i = alone; i < times; i += each) {
      check(cudaGraphLaunch(graph, backend_.stream()), "graph launch");
    }
  }

 private:
  static unsigned blocks(std::int64_t n) {
    return static_cast<unsigned>((n + graph_run_threads - 1) / graph_run_threads);
  }

  template <int lanes, bool shares, class Pass>
  void start_pass(std::int64_t count, const Pass& pass) {
    const unsigned helping = (pass.helped_places() + graph_run_warps - 1) / graph_run_warps;
    launch(run_shared_pass<lanes, shares, Pass>, helping + blocks(count * lanes), graph_run_threads, count, helping,
           pass);
  }

  template <class... Parameters, class... Arguments>
  void launch(void (*kernel)(Parameters...), unsigned blocks, int threads, const Arguments&... arguments) {
    cudaLaunchConfig_t config{};
    config.gridDim = {blocks, 1, 1};
    config.blockDim = {static_cast<unsigned>(threads), 1, 1};
    config.stream = backend_.stream();
    cudaLaunchAttribute early{};
    early.id = cudaLaunchAttributeProgrammaticStreamSerialization;
    early.val.programmaticStreamSerializationAllowed = 1;
    config.attrs = &early;
    config.numAttrs = can_launch_early_ ? 1 : 0;
    check(cudaLaunchKernelEx(&config, kernel, arguments...), "kernel launch");
  }

  template <class Body>
  cudaGraphExec_t record(std::int64_t times, const Body& body) {
    cudaGraph_t recorded = nullptr;
    check(cudaStreamBeginCapture(backend_.stream(), cudaStreamCaptureModeThreadLocal), "graph capture");
    try {
      for (std::int64_t i = 0; i < times; ++i) body();
    } catch (...) {
      cudaStreamEndCapture(backend_.stream(), &recorded);
      cudaGraphDestroy(recorded);
      throw;
    }
    check(cudaStreamEndCapture(backend_.stream(), &recorded), "graph capture");
    cudaGraphExec_t graph = nullptr;
    const cudaError_t status = cudaGraphInstantiate(&graph, recorded, 0);
    cudaGraphDestroy(recorded);
    check(status, "graph instantiation");
    return graph;
  }

  CudaBackend& backend_;
  StageTimer& timer_;
  FrameGraphs& graphs_;
  std::uint32_t lanes_;
  bool shares_pairs_;
  OnDevice on_;
  bool can_launch_early_ = false;
};

template <>
struct FrameRunner<CudaBackend> {
  FrameGraphs graphs;
  GraphRun run(CudaBackend& backend, StageTimer& timer, std::uint32_t lanes, bool shares_pairs) {
    return {backend, timer, graphs, lanes, shares_pairs};
  }
};

}  // namespace fastcollide
