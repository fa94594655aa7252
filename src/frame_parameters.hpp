// What a frame of either solver needs to know besides the spheres.
#pragma once

#include "fastcollide/world.hpp"
#include "stages/solve_contacts.hpp"
#include "stages/substep_scratch.hpp"

namespace fastcollide {

struct FrameParameters {
  Solver solver;
  int iterations;
  SolverScales scales;
  Substep substep;  // the reference solver's is a frame
};

}  // namespace fastcollide
