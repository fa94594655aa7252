// Runs stages one after the other on a backend, each with its time.
#pragma once

#include "backend/concept.hpp"
#include "stage_timer.hpp"

namespace fastcollide {

template <Backend B>
class HostRun {
 public:
  HostRun(B& backend, StageTimer& timer) : backend_(backend), timer_(timer) {}

  template <class F>
  void for_each(Stage stage, std::int64_t n, const F& f) {
    timer_.time(backend_, stage, [&] { backend_.for_each(n, f); });
  }
  template <class Pass>
  void for_each_sphere(Stage stage, std::int64_t n, const Pass& pass) {
    if constexpr (requires { pass.helped_places(); }) {
      for_each(stage, pass.helped_places(), [=](std::int64_t place) {
        if (const std::uint32_t slot = pass.helped_in(place); slot != no_slot) pass(slot);
      });
      for_each(stage, n, [=](std::int64_t slot) {
        if (!pass.is_helped(slot)) pass(slot);
      });
    } else {
      for_each(stage, n, pass);
    }
  }
  // Runs pass(i) for the records of those for whom find() is true.
  template <class Find, class Record, class Pass>
  void for_each_with_record(Stage stage, std::int64_t n, const Find& find, Record* records, const Pass& pass) {
    for_each(stage, n, [=](std::int64_t slot) {
      Record record;
      record.slot = static_cast<std::uint32_t>(slot);
      if (find(slot, record.count, [&](std::uint32_t k) -> std::uint32_t& { return record.near[k]; })) {
        records[atomic_add(find.record_counts(), 1)] = record;
      }
    });
    for_each(stage, read(static_cast<const std::uint32_t*>(find.record_counts())), pass);
  }
  template <class Pass>
  void for_each_of_groups(Stage stage, const SlotGroups& groups, const Pass& pass) {
    timer_.time(backend_, stage, [&] { backend_.for_each_of_groups(groups, pass); });
  }
  template <class F>
  void alone(const F& f) {
    backend_.for_each(1, f);
  }
  // Writes the sum of the counts before each one, n + 1 in all, and leaves the counts at zero.
  void exclusive_scan(Stage stage, std::uint32_t* counts, std::uint32_t* sums, std::int64_t n) {
    timer_.time(backend_, stage, [&] {
      backend_.exclusive_scan(static_cast<const std::uint32_t*>(counts), sums, n);
      backend_.fill_zero(counts, n);
    });
  }
  // Gives each cell of a frame the slots of its spheres, from their counts, which stay.
  template <class World>
  void allocate_cells(Stage stage, World& world) {
    timer_.time(backend_, stage, [&] {
      backend_.exclusive_scan(static_cast<const std::uint32_t*>(world.cell_counts), world.cell_start, world.cells);
    });
  }
  template <class World, class Body>
  void repeat(World&, std::int64_t times, const Body& body) {
    for (std::int64_t i = 0; i < times; ++i) body();
  }
  template <class T>
  T read(const T* word) {
    T value;
    backend_.copy_to_host(&value, word, 1);
    return value;
  }

 private:
  B& backend_;
  StageTimer& timer_;
};

// What starts the stages of frames with lists of their own; backend/graph_run.cuh has that of CUDA.
template <Backend B>
struct FrameRunner {
  HostRun<B> run(B& backend, StageTimer& timer, std::uint32_t, bool) { return {backend, timer}; }
};

}  // namespace fastcollide
