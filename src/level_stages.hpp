// How a backend runs the stages of level_step.hpp.
#pragma once

#include "host_run.hpp"

namespace fastcollide {

// One after the other; cpu/level_stages.hpp has what a CPU does.
template <Backend B>
class LevelRun : public HostRun<B> {
 public:
  using HostRun<B>::HostRun;
};

}  // namespace fastcollide
