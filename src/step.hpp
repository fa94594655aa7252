// The frame of each solver, on one page.
#pragma once

#include "contact_memory.hpp"
#include "fastcollide/world.hpp"
#include "frame_parameters.hpp"
#include "stage_timer.hpp"
#include "stages/advance.hpp"
#include "stages/apply_contacts.hpp"
#include "stages/build_grid.hpp"
#include "stages/gather_contacts.hpp"
#include "stages/measure_crowding.hpp"
#include "stages/solve_contacts.hpp"

namespace fastcollide {

template <Backend B>
struct Scratch {
  explicit Scratch(B& backend) : grid(backend), substep(backend), watch(backend) { watch.resize(1); }

  Grid<B> grid;
  SubstepScratch<B> substep;
  typename B::template Buffer<Watch> watch;  // one
};

// The report's frame: flight and walls, then `iterations` times a new grid and one pass over all contacts. A pass reads
// the copy of the state in the grid and writes the bodies, so no sphere sees a neighbour half changed.
template <Backend B>
void simulate_reference_frame(B& backend, const FrameParameters& frame, Bodies<B>& bodies, Scratch<B>& scratch,
                              StageTimer& timer) {
  const Substep& step = frame.substep;
  Watch* watch = scratch.watch.data();
  timer.time(backend, Stage::advance,
             [&] { advance(backend, step.flight, step.box, step.wall, step.frame, bodies, watch); });
  for (int iteration = 0; iteration < frame.iterations; ++iteration) {
    timer.time(backend, Stage::build_grid, [&] { build_grid(backend, bodies, nullptr, scratch.grid); });
    timer.time(backend, Stage::solve_contacts, [&] {
      solve_contacts(backend, frame.scales, step.box, step.frame, scratch.grid, bodies, &watch->first_fault);
    });
  }
}

// The default frame: `iterations` substeps, each with a new grid, one pass that gathers all contacts and one that
// applies them and moves the spheres. The crowding that a substep needs is that of the substep before.
template <Backend B>
void simulate_substep_frame(B& backend, const FrameParameters& frame, Bodies<B>& bodies, const MemoryCopies& memory,
                            Scratch<B>& scratch, StageTimer& timer) {
  Watch* watch = scratch.watch.data();
  for (int substep = 0; substep < frame.iterations; ++substep) {
    const auto pass =
        frame.substep.frame * static_cast<std::uint32_t>(frame.iterations) + static_cast<std::uint32_t>(substep);
    const MemoryPass remembered = memory.of_pass(pass);
    timer.time(backend, Stage::build_grid,
               [&] { build_grid(backend, bodies, scratch.substep.crowding.data(), scratch.grid); });
    timer.time(backend, Stage::gather_contacts, [&] {
      gather_contacts(backend, frame.substep, scratch.grid, bodies, scratch.substep, remembered, &watch->first_fault);
    });
    timer.time(backend, Stage::apply_contacts, [&] {
      apply_contacts(backend, frame.substep, scratch.grid, bodies, scratch.substep, remembered, watch);
    });
  }
}

template <Backend B>
void simulate_frame(B& backend, const FrameParameters& frame, Bodies<B>& bodies, const MemoryCopies& memory,
                    Scratch<B>& scratch, StageTimer& timer) {
  if (frame.solver == Solver::reference) {
    simulate_reference_frame(backend, frame, bodies, scratch, timer);
  } else {
    simulate_substep_frame(backend, frame, bodies, memory, scratch, timer);
  }
}

}  // namespace fastcollide
