// The frame, on one page.
#pragma once

#include "stage_timer.hpp"
#include "stages/advance.hpp"
#include "stages/build_grid.hpp"
#include "stages/solve_contacts.hpp"

namespace fastcollide {

struct FrameParameters {
  Flight flight;
  Box box;
  WallMaterial wall;
  int iterations;
  SolverScales scales;
  std::uint32_t frame;  // since the start of the run
};

// The report's frame: flight and walls, then `iterations` times a new grid and one pass over all contacts. A pass reads
// the copy of the state in the grid and writes the bodies, so no sphere sees a neighbour half changed.
template <Backend B>
void simulate_frame(B& backend, const FrameParameters& frame, Bodies<B>& bodies, Grid<B>& grid,
                    std::uint64_t* first_fault, StageTimer& timer) {
  timer.time(backend, "advance",
             [&] { advance(backend, frame.flight, frame.box, frame.wall, frame.frame, bodies, first_fault); });
  for (int iteration = 0; iteration < frame.iterations; ++iteration) {
    timer.time(backend, "build_grid", [&] { build_grid(backend, bodies, grid); });
    timer.time(backend, "solve_contacts",
               [&] { solve_contacts(backend, frame.scales, frame.box, frame.frame, grid, bodies, first_fault); });
  }
}

}  // namespace fastcollide
