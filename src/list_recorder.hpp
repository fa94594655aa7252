// How a backend makes the lists of all spheres, right after a sort.
#pragma once

#include "host_run.hpp"
#include "listed_step.hpp"

namespace fastcollide {

// Each sphere by itself; list_recorder_cpu.hpp has what a CPU does.
template <Backend B>
class ListRecorder {
 public:
  explicit ListRecorder(B&) {}
  void resize(std::int64_t) {}

  template <class Run>
  void record(Run& run, ListedWorld& world) {
    run.for_each(Stage::make_lists, world.count * world.lists.lanes, record_lists_of(world));
  }
};

// The stages of listed_step.hpp one by one on a backend.
template <Backend B>
class ListedRun : public HostRun<B> {
 public:
  ListedRun(B& backend, StageTimer& timer, ListRecorder<B>& recorder)
      : HostRun<B>(backend, timer), recorder_(recorder) {}

  void record_lists(ListedWorld& world) { recorder_.record(*this, world); }

 private:
  ListRecorder<B>& recorder_;
};

}  // namespace fastcollide
