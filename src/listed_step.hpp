// Frames by lists: the same results as step.hpp, faster. The spheres stay sorted by cell from pass to pass, and a pass
// looks for neighbours in lists that hold until some sphere has moved too far.
//
// `Run` runs the stages: HostRun one after the other on a backend, or one kernel that holds all threads of a GPU. Where
// this page asks run.read(), every thread gets the same answer.
#pragma once

#include "frame_parameters.hpp"
#include "stage_timer.hpp"
#include "stages/advance.hpp"
#include "stages/apply_contacts.hpp"
#include "stages/gather_contacts.hpp"
#include "stages/sort_slots.hpp"

namespace fastcollide {

// Plain pointers and numbers: the argument of a kernel.
struct ListedWorld {
  FrameParameters frame;
  std::int64_t count;
  std::uint32_t frames;
  bool is_new, must_load;  // slots that hold nothing yet; bodies that the slots do not know
  BodyArrays bodies;
  SlotState state, other_state;
  MassId *mass_ids, *other_mass_ids;
  Vec4* built;
  GridShape shape;
  std::int64_t cells;
  std::uint32_t *cell_of_slot, *rank_of_slot, *sorted_cells, *cell_counts, *cell_start;
  NeighborLists lists;
  SkinLaw skin;
  QueuedSphere* queues;  // two, in turn
  std::uint32_t queue_places;
  Vec3* velocity_change;
  Vec3* turn;  // or null
  std::uint32_t* pick;
  ListControl* control;
  MemoryCopies memory;

  FC_HOST_DEVICE std::uint32_t contact_passes() const { return static_cast<std::uint32_t>(frame.iterations); }
  FC_HOST_DEVICE GridView grid() const { return view_of(state, mass_ids, count, period_of(frame.substep.box)); }
  // Where the pass with this turn writes. What it tells, the pass with the next turn reads.
  FC_HOST_DEVICE ToSlots output(std::uint32_t turn, bool is_repaired) const {
    const std::uint32_t mine = turn % 2;
    return {other_state,
            built,
            period_of(frame.substep.box),
            lists,
            skin,
            shape,
            sorted_cells,
            queues + mine * std::int64_t(queue_places),
            queue_places,
            &control->news[mine],
            is_repaired};
  }
  FC_HOST_DEVICE void swap_state() {
    const SlotState held = state;
    state = other_state;
    other_state = held;
  }
  FC_HOST_DEVICE void swap_mass_ids() {
    MassId* held = mass_ids;
    mass_ids = other_mass_ids;
    other_mass_ids = held;
  }
};

// How far the frames have come.
struct Progress {
  std::uint32_t frame, pass, age, turn, state_swaps, sorts;
};

struct StoreProgress {
  Progress progress;
  ListControl* control;

  FC_HOST_DEVICE void operator()(std::int64_t) const {
    control->frame = progress.frame;
    control->pass = progress.pass;
    control->age = progress.age;
    control->turn = progress.turn;
    control->state_swaps = progress.state_swaps;
    control->sorts = progress.sorts;
  }
};

struct AdvanceSlots {
  AdvanceSphere advance;
  GridView grid;
  ToSlots output;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const Sphere sphere = sphere_in_slot(grid, slot);
    Vec3 position = sphere.position, velocity = sphere.velocity;
    advance(sphere.id, sphere.radius, sphere.mass, sphere.restitution, position, velocity);
    output.write(slot, sphere, position, velocity, spin_in_slot(grid, slot));
  }
};

FC_HOST_DEVICE inline RecordLists record_lists_of(const ListedWorld& world) {
  return {world.shape,      period_of(world.frame.substep.box),
          world.cell_start, world.state.position_radius,
          world.mass_ids,   world.built,
          world.skin,       world.lists,
          world.control};
}

FC_EITHER_SIDE
template <class Run>
FC_HOST_DEVICE void make_lists(Run& run, ListedWorld& world, Progress& progress) {
  run.for_each(
      Stage::build_grid, world.count,
      CountCells{world.shape, world.state.position_radius, world.cell_of_slot, world.rank_of_slot, world.cell_counts});
  run.alone(ForgetNews{world.control});
  run.exclusive_scan(Stage::build_grid, world.cell_counts, world.cell_start, world.cells);
  run.for_each(Stage::build_grid, world.count,
               ScatterSlots{world.cell_of_slot,
                            world.rank_of_slot,
                            world.cell_start,
                            world.skin,
                            {world.state, world.other_state, world.mass_ids, world.other_mass_ids},
                            world.built,
                            world.sorted_cells});
  world.swap_state();
  world.swap_mass_ids();
  ++progress.state_swaps;
  ++progress.sorts;
  progress.age = 0;
  if constexpr (requires { run.record_lists(world); }) {
    run.record_lists(world);
  } else {
    run.for_each(Stage::make_lists, world.count * world.lists.lanes, record_lists_of(world));
  }
}

// Lists keep what has gone away since, so now and then all are made anew.
inline constexpr std::uint32_t oldest_lists = 32;  // frames

// Adds to the lists what they lack since the last pass. False when they must be made anew.
FC_EITHER_SIDE
template <class Run>
FC_HOST_DEVICE bool repair_lists(Run& run, ListedWorld& world, const Progress& progress) {
  const std::uint32_t before = (progress.turn + 1) % 2;
  const ListNews news = run.read(&world.control->news[before]);
  if (news.is_stale != 0 || news.queued > world.queue_places) return false;
  if (progress.age >= oldest_lists * world.contact_passes()) return false;
  if (news.queued == 0) return true;
  run.for_each(Stage::make_lists, std::int64_t(news.queued) * RepairLists::lanes,
               RepairLists{world.shape, period_of(world.frame.substep.box), world.cell_start,
                           world.queues + before * std::int64_t(world.queue_places), world.state.position_radius,
                           world.mass_ids, world.built, world.skin, world.lists, world.control});
  run.alone(ForgetQueue{&world.control->news[before]});
  return run.read(&world.control->longest) <= world.lists.capacity;
}

// True when the lists hold all that the next pass needs, false when they have too little room for it.
FC_EITHER_SIDE
template <class Run>
FC_HOST_DEVICE bool update_lists(Run& run, ListedWorld& world, Progress& progress) {
  if (repair_lists(run, world, progress)) return true;
  make_lists(run, world, progress);
  return run.read(&world.control->longest) <= world.lists.capacity;
}

FC_EITHER_SIDE
template <class Run>
FC_HOST_DEVICE void advance_slots(Run& run, ListedWorld& world, Progress& progress) {
  const Substep& step = world.frame.substep;
  run.for_each(Stage::advance, world.count,
               AdvanceSlots{{step.flight, step.box, step.wall, step.frame, &world.control->watch},
                            world.grid(),
                            world.output(progress.turn - 1, false)});
  world.swap_state();
  ++progress.state_swaps;
}

// One iteration of the reference solver, one substep of the default one.
FC_EITHER_SIDE
template <Solver solver, class Run>
FC_HOST_DEVICE void solve_slots(Run& run, ListedWorld& world, Progress& progress) {
  const FrameParameters& frame = world.frame;
  const Substep& step = frame.substep;
  const ListedNeighbors neighbors{world.lists, world.skin.reach};
  const ToSlots output = world.output(progress.turn, true);
  const MemoryPass memory = world.memory.of_pass(progress.frame * world.contact_passes() + progress.pass);
  Watch* watch = &world.control->watch;
  if constexpr (solver == Solver::reference) {
    run.for_each_sphere(Stage::solve_contacts, world.count,
                        SolveContacts<ListedNeighbors, ToSlots>{frame.scales, step.box, step.frame, world.grid(),
                                                                neighbors, output, &watch->first_fault});
  } else {
    run.for_each_sphere(
        Stage::gather_contacts, world.count,
        GatherContacts<ListedNeighbors, ToSlots>{step, world.grid(), neighbors, output, world.velocity_change,
                                                 world.turn, world.pick, &watch->first_fault, memory});
    run.for_each(Stage::apply_contacts, world.count,
                 ApplyContacts<ToSlots>{step, world.grid(), output, world.velocity_change, world.turn, world.pick,
                                        watch, memory.cleared});
  }
  world.swap_state();
  ++progress.state_swaps;
  ++progress.age;
  ++progress.turn;
}

// Runs frames until all are done, a list needs more room than it has, or something went wrong.
FC_EITHER_SIDE
template <Solver solver, class Run>
FC_HOST_DEVICE void simulate_listed_frames(Run& run, ListedWorld world) {
  ListControl* control = world.control;
  Progress progress{
      run.read(&control->frame), run.read(&control->pass), run.read(&control->age), run.read(&control->turn), 0, 0};
  if (world.must_load) {
    run.for_each(
        Stage::load, world.count,
        LoadSlots{world.is_new, world.bodies, world.mass_ids, world.state, world.output(progress.turn - 1, false)});
  }
  constexpr bool is_reference = solver == Solver::reference;
  const std::uint32_t passes = world.contact_passes() + (is_reference ? 1 : 0);  // with the flight of the reference
  bool has_room = true, is_fine = true;
  while (has_room && is_fine && progress.frame < world.frames) {
    world.frame.substep.frame = progress.frame;
    while (has_room && progress.pass < passes) {
      if (is_reference && progress.pass == 0) {
        advance_slots(run, world, progress);
      } else if (update_lists(run, world, progress)) {
        solve_slots<solver>(run, world, progress);
      } else {
        has_room = false;
        break;
      }
      ++progress.pass;
    }
    if (progress.pass == passes) {
      // Not: is there any fault? Some threads may already be at the next frame when the last one asks.
      is_fine = fault_frame(run.read(&control->watch.first_fault)) > progress.frame;
      ++progress.frame;
      progress.pass = 0;
    }
  }
  // Else the bodies stay as they were before the first of these frames.
  if (is_fine && progress.frame == world.frames) {
    run.for_each(Stage::store, world.count, StoreBodies{world.state, world.mass_ids, world.bodies});
  }
  run.alone(StoreProgress{progress, control});
}

template <Solver solver>
struct SimulateListedFrames {
  ListedWorld world;

  FC_EITHER_SIDE
  template <class Run>
  FC_HOST_DEVICE void operator()(Run& run) const {
    simulate_listed_frames<solver>(run, world);
  }
};

}  // namespace fastcollide
