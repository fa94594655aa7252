// How a backend runs the two largest stages of listed_step.hpp: the lists of all spheres and the contacts of a substep.
#pragma once

#include "host_run.hpp"
#include "listed_step.hpp"

namespace fastcollide {

// Each sphere by itself; cpu/listed_stages.hpp has what a CPU does.
template <Backend B>
class ListedStages {
 public:
  explicit ListedStages(B&) {}
  void resize(std::int64_t) {}

  template <class Run>
  void record_lists(Run& run, ListedWorld& world) {
    run.for_each(Stage::make_lists, world.count * world.lists.lanes, record_lists_of(world));
  }
  template <class Run, class Pass>
  void pass_contacts(Run& run, Stage stage, std::int64_t count, const Pass& pass) {
    run.for_each(stage, count, pass);
  }
};

template <Backend B>
class ListedRun : public HostRun<B> {
 public:
  ListedRun(B& backend, StageTimer& timer, ListedStages<B>& stages) : HostRun<B>(backend, timer), stages_(stages) {}

  void record_lists(ListedWorld& world) { stages_.record_lists(*this, world); }
  template <class Pass>
  void for_each_sphere(Stage stage, std::int64_t count, const Pass& pass) {
    stages_.pass_contacts(*this, stage, count, pass);
  }

 private:
  ListedStages<B>& stages_;
};

}  // namespace fastcollide
