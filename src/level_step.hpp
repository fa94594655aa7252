// Frames of spheres of very different sizes: the same results as step.hpp, with a new sort into grids of several levels
// for every pass. A pass looks through the cells at once, without lists: in these worlds small spheres soon leave any
// skin, and large ones have more neighbours than a list should hold.
#pragma once

#include <algorithm>
#include <utility>

#include "frame_parameters.hpp"
#include "stage_timer.hpp"
#include "stages/apply_contacts.hpp"
#include "stages/gather_contacts.hpp"
#include "stages/known_world.hpp"
#include "stages/sort_level_slots.hpp"

namespace fastcollide {

// Plain pointers and numbers. Stages get parts of it.
struct LevelWorld {
  FrameParameters frame;
  std::int64_t count;
  bool is_new;  // slots that hold nothing yet
  BodyArrays bodies;
  SlotState state, other_state;
  MassId *mass_ids, *other_mass_ids;
  const CellLevels* levels;
  std::int64_t cells;  // of all levels
  SlotGroups groups;
  std::uint32_t *cell_of_slot, *rank_of_slot, *cell_counts, *cell_start;
  Vec3* velocity_change;
  Vec3* turn;  // or null
  std::uint32_t* pick;
  MemoryCopies memory;
  Watch* watch;

  GridView grid() const { return view_of(state, mass_ids, count, period_of(frame.substep.box)); }
  LevelNeighbors neighbors() const { return {levels, cell_start, cell_start + 1}; }
  ToNextPass to_next_pass(bool ends_frame, bool is_last) const {
    const Substep& step = frame.substep;
    return {other_state,
            {levels, cell_of_slot, rank_of_slot, cell_counts},
            {step.flight, step.box, step.wall, step.frame + 1, watch},
            frame.solver == Solver::reference && ends_frame && !is_last,
            !is_last};
  }
  void swap_state() { std::swap(state, other_state); }
};

template <class Pass, bool is_rough, bool has_walls>
struct LevelPass {
  static constexpr bool has_friction = is_rough;
  Pass pass;

  FC_HOST_DEVICE Pass now() const { return in_known_world<is_rough, has_walls>(pass); }
  FC_HOST_DEVICE void operator()(std::int64_t slot) const { now()(slot); }
};

template <class Pass, bool is_rough, bool has_walls>
struct SharedLevelPass : LevelPass<Pass, is_rough, has_walls> {
  using Sum = typename Pass::Sum;

  FC_HOST_DEVICE Sum gather(std::int64_t slot, Lane lane) const { return this->now().gather(slot, lane); }
  FC_HOST_DEVICE void finish(std::int64_t slot, const Sum& sum) const { this->now().finish(slot, sum); }
};

template <class Run>
void sort_by_levels(Run& run, LevelWorld& world) {
  run.exclusive_scan(Stage::build_grid, world.cell_counts, world.cell_start, world.cells);
  run.for_each(Stage::build_grid, world.count,
               ScatterLevelSlots{world.cell_of_slot,
                                 world.rank_of_slot,
                                 world.cell_start,
                                 {world.state, world.other_state, world.mass_ids, world.other_mass_ids}});
  world.swap_state();
  std::swap(world.mass_ids, world.other_mass_ids);
}

// One iteration of the reference solver, one substep of the default one.
template <bool is_rough, bool has_walls, class Run>
void run_level_pass(Run& run, LevelWorld& world, std::uint32_t pass, const ToNextPass& output) {
  const Substep& step = world.frame.substep;
  const auto run_groups = [&]<class Pass>(Stage stage, const Pass& contacts) {
    run.for_each_of_groups(stage, world.groups, SharedLevelPass<Pass, is_rough, has_walls>{{contacts}});
  };
  if (world.frame.solver == Solver::reference) {
    run_groups(Stage::solve_contacts,
               SolveContacts<LevelNeighbors, ToNextPass>{world.frame.scales, step.box, step.frame, world.grid(),
                                                         world.neighbors(), output, &world.watch->first_fault});
  } else {
    const MemoryPass memory = world.memory.of_pass(pass);
    run_groups(Stage::gather_contacts, GatherContacts<LevelNeighbors, ToNextPass>{
                                           step, world.grid(), world.neighbors(), output, world.velocity_change,
                                           world.turn, world.pick, &world.watch->first_fault, memory});
    run.for_each(
        Stage::apply_contacts, world.count,
        LevelPass<ApplyContacts<ToNextPass>, is_rough, has_walls>{
            {step, world.grid(), output, world.velocity_change, world.turn, world.pick, world.watch, memory.cleared}});
  }
  world.swap_state();
}

template <bool is_rough, bool has_walls, class Run>
void simulate_frames_by_levels(Run& run, LevelWorld& world, std::uint32_t frames) {
  world.frame.substep.frame = ~std::uint32_t(0);
  ToNextPass first = world.to_next_pass(true, false);
  first.to = world.state;
  run.for_each(Stage::load, world.count, LoadInto<ToNextPass>{world.is_new, world.bodies, world.mass_ids, first});
  const auto passes = static_cast<std::uint32_t>(world.frame.iterations);
  for (std::uint32_t frame = 0; frame < frames; ++frame) {
    world.frame.substep.frame = frame;
    for (std::uint32_t pass = 0; pass < passes; ++pass) {
      const bool ends_frame = pass + 1 == passes;
      sort_by_levels(run, world);
      run_level_pass<is_rough, has_walls>(run, world, frame * passes + pass,
                                          world.to_next_pass(ends_frame, ends_frame && frame + 1 == frames));
    }
  }
  run.for_each(Stage::store, world.count, StoreLevelBodies{{world.state, world.mass_ids, world.bodies}, world.watch});
}

}  // namespace fastcollide
