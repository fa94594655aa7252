// Frames with lists made once for some of them: the same results as step.hpp, as a short chain of stages that asks the
// host for nothing, so that a GPU can be given many frames at once.
//
// `Run` starts the stages: HostRun one after the other on a backend, GraphRun as nodes of a CUDA graph.
#pragma once

#include <algorithm>
#include <type_traits>
#include <utility>

#include "frame_parameters.hpp"
#include "stage_timer.hpp"
#include "stages/apply_contacts.hpp"
#include "stages/gather_contacts.hpp"
#include "stages/known_world.hpp"
#include "stages/near_records.hpp"
#include "stages/sort_frame_slots.hpp"

namespace fastcollide {

// Plain pointers and numbers. Stages get parts of it.
struct FrameWorld {
  FrameParameters frame;
  std::uint32_t frames_of_lists;  // in which they are kept
  std::int64_t count;
  bool is_new;        // slots that hold nothing yet
  bool shares_pairs;  // rough, and where four lanes have a sphere they share the pairs of their warp
  BodyArrays bodies;
  SlotState state, other_state;
  MassId *mass_ids, *other_mass_ids;
  Vec4* built;  // place, radius and skin
  GridShape shape;
  std::int64_t cells;
  std::uint32_t *cell_of_slot, *cell_counts, *cell_start, *cell_end;
  FrameLists lists;
  Strays strays, other_strays;  // of the passes with an even and an odd number
  SkinLaw skin;
  Drift drift;
  Vec3* velocity_change;
  Vec3* turn;  // or null
  std::uint32_t* pick;
  NearRecord* room_for_records;  // or null: there is none
  NearRecord* near_records;      // or null: contact passes take all spheres
  FrameControl* control;
  MemoryPass memory;  // of the next pass

  GridView grid() const { return view_of(state, mass_ids, count, period_of(frame.substep.box)); }
  CellCounter counter() const { return {shape, cell_of_slot, cell_counts}; }
  SortedSlots sorted() const { return {shape, cell_start, cell_end, built, skin}; }
  Strays strays_of(std::uint32_t pass) const {
    Strays found = pass % 2 == 0 ? strays : other_strays;
    found.pass = pass;
    return found;
  }
  // Which of the frames with these lists a pass belongs to.
  std::uint32_t frame_of(std::uint32_t pass) const { return pass / static_cast<std::uint32_t>(frame.iterations); }
  // Of the lists, before a pass; the reference solver flies at the end of a frame alone.
  float age_at(std::uint32_t pass) const {
    const std::uint32_t flights = frame.solver == Solver::substep ? pass : frame_of(pass);
    return frame.substep.flight.dt * static_cast<float>(flights);
  }
  FrameListNeighbors neighbors(std::uint32_t pass) const {
    return {sorted(), lists, strays_of(pass == 0 ? 0 : pass - 1), pass == 0, age_at(pass)};
  }
  ToFrameSlots to_slots(std::uint32_t pass) const {
    return {other_state, period_of(frame.substep.box), sorted(), strays_of(pass), lists.counts, age_at(pass + 1)};
  }
  ToFlyingSlots to_flying_slots(std::uint32_t pass) const { return {to_slots(pass), flight(), frame_of(pass + 1)}; }
  AdvanceSphere flight() const {
    const Substep& step = frame.substep;
    return {step.flight, step.box, step.wall, 0, &control->watch};
  }
  ToNextFrame to_next_frame(bool is_last) const {
    return {other_state, counter(), flight(), frame.solver == Solver::reference, is_last, control};
  }
  void swap_state() { std::swap(state, other_state); }
};

// A pass in a frame whose number only the device knows.
template <class Pass, bool is_rough, bool has_walls>
struct FramePass {
  using ListNeighbors = FrameListNeighbors;
  static constexpr bool has_friction = is_rough;
  Pass pass;
  const FrameControl* control;
  std::uint32_t frame;  // of those with the same lists

  FC_HOST_DEVICE Pass now() const {
    Pass here = in_known_world<is_rough, has_walls>(pass);
    if constexpr (requires { here.substep; }) {
      here.substep.frame = control->frame + frame;
    } else {
      here.frame = control->frame + frame;
    }
    return here;
  }
  FC_HOST_DEVICE Pass at(std::int64_t slot) const {
    Pass here = now();
    if constexpr (requires { here.output.begin(slot); }) here.output.begin(slot);
    return here;
  }
};

// A pass that several lanes may share: at(slot), and of that load(slot), gather() and finish().
template <class Pass, bool is_rough, bool has_walls>
struct SharedFramePass : FramePass<Pass, is_rough, has_walls> {
  using Sum = typename Pass::Sum;
  static constexpr bool gets_help = Pass::gets_help;

  FC_HOST_DEVICE bool is_helped(std::int64_t slot) const {
    return (this->pass.neighbors.lists.counts[slot] & FrameLists::helped_bit) != 0;
  }
  // How many strays may get help, and which one is in a place: a slot, or no_slot.
  std::uint32_t helped_places() const {
    return this->pass.neighbors.is_first ? 0 : this->pass.neighbors.strays.helped_places;
  }
  FC_HOST_DEVICE std::uint32_t helped_in(std::int64_t place) const {
    return this->pass.neighbors.strays.helped_in(static_cast<std::uint32_t>(place));
  }

  FC_HOST_DEVICE void operator()(std::int64_t slot) const { run_alone(this->at(slot), slot); }
};

template <class Pass, bool is_rough, bool has_walls>
struct SingleFramePass : FramePass<Pass, is_rough, has_walls> {
  FC_HOST_DEVICE void operator()(std::int64_t slot) const { this->at(slot)(slot); }
};

// One that takes the spheres of records.
template <class Pass, bool is_rough, bool has_walls>
struct NearFramePass : FramePass<Pass, is_rough, has_walls> {
  using Sum = typename Pass::Sum;
  const NearRecord* records;

  static constexpr std::uint32_t places = NearRecord::places;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    const std::int64_t slot = records[i].slot;
    Pass here = this->at(slot);
    here.neighbors.near = records[i].near;
    here.neighbors.count = records[i].count;
    const Sphere self = here.load(slot);
    here.finish(self, slot, here.gather(self, slot, Lane{}));
  }
};

template <bool has_walls>
struct FindNearInFrame : FindNear {
  template <class Near>
  FC_HOST_DEVICE bool operator()(std::int64_t slot, std::uint32_t& count, const Near& near) const {
    FindNear here = *this;
    if constexpr (has_walls) here.assume_walls();
    return here(slot, count, near);
  }
};

template <bool is_shared, bool has_walls>
struct RecordListsOfFrame {
  RecordFrameLists<is_shared> record;

  FC_HOST_DEVICE void operator()(std::int64_t row) const {
    RecordFrameLists<is_shared> here = record;
    if constexpr (has_walls) here.assume_walls();
    here(row);
  }
};

template <bool has_walls, class Run>
void make_frame_lists(Run& run, FrameWorld& world, std::uint32_t frames) {
  run.allocate_cells(Stage::build_grid, world);
  run.for_each(Stage::build_grid, world.count,
               ScatterFrameSlots{frames,
                                 world.counter(),
                                 world.cell_start,
                                 world.skin,
                                 {world.state, world.other_state, world.mass_ids, world.other_mass_ids},
                                 world.built,
                                 world.lists.counts,
                                 world.drift,
                                 world.control});
  world.swap_state();
  std::swap(world.mass_ids, world.other_mass_ids);
  const auto record = [&]<bool is_shared>() {
    run.for_each(Stage::make_lists, world.count << world.lists.lane_bits,
                 RecordListsOfFrame<is_shared, has_walls>{{world.sorted(), period_of(world.frame.substep.box),
                                                           world.mass_ids, world.lists, world.drift, world.control}});
  };
  if (world.lists.lane_bits > 0) {
    record.template operator()<true>();
  } else {
    record.template operator()<false>();
  }
}

// To find out who is near before a contact pass pays where that then has few spheres to take. On an H100, 1,000,000 of
// which 6 %, 20 % and 25 % are touched took 0.75, 0.89 and 1.44 ms, without it 0.81, 0.98 and 1.54; where nearly all
// are it took half as long again. With friction, where lanes share the pairs, it pays as long as some are
// untouched: 1.05, 1.35 and 2.29 in place of 1.26, 1.77 and 3.07, and in a pile 9.0 in place of 6.9.
inline void choose_near_records(FrameWorld& world, std::int64_t touched) {
  const std::int64_t all = world.drift.samples;
  const bool is_rough = world.state.spins != nullptr, pays = is_rough ? 8 * touched < 7 * all : 3 * touched < all;
  world.near_records = pays ? world.room_for_records : nullptr;
}
inline constexpr std::int64_t frames_to_look = 16;  // whether that pays, and whether lists do

inline FindNear find_near(const FrameWorld& world, std::uint32_t pass) {
  const SoftContactLaw& law = world.frame.substep.law;
  return {world.grid(),
          world.neighbors(pass),
          world.frame.substep.box,
          world.frame.substep.flight,
          -law.impact_speed * law.substep,
          world.other_state.crowding,
          world.pick,
          pass,
          world.control};
}

// One iteration of the reference solver, one substep of the default one.
template <bool is_rough, bool has_walls, class Run, class Output>
void run_pass(Run& run, FrameWorld& world, std::uint32_t pass, const Output& output) {
  const Substep& step = world.frame.substep;
  Watch* watch = &world.control->watch;
  if (world.frame.solver == Solver::reference) {
    using Solve = SolveContacts<FrameListNeighbors, Output>;
    run.for_each_sphere(Stage::solve_contacts, world.count,
                        SharedFramePass<Solve, false, has_walls>{{{world.frame.scales, step.box, 0, world.grid(),
                                                                   world.neighbors(pass), output, &watch->first_fault},
                                                                  world.control,
                                                                  world.frame_of(pass)}});
  } else if constexpr (!std::is_same_v<Output, ToFlyingSlots>) {
    // Of its output it writes the crowding alone, which is the same in every pass.
    const auto gather = [&]<class Neighbors>(const Neighbors& neighbors) {
      using Gather = GatherContacts<Neighbors, ToFrameSlots>;
      return FramePass<Gather, is_rough, has_walls>{
          {step, world.grid(), neighbors, world.to_slots(pass), world.velocity_change, world.turn, world.pick,
           &watch->first_fault, world.memory},
          world.control,
          world.frame_of(pass)};
    };
    if (world.near_records != nullptr) {
      run.for_each_with_record(Stage::gather_contacts, world.count, FindNearInFrame<has_walls>{find_near(world, pass)},
                               world.near_records,
                               NearFramePass<GatherContacts<NearNeighbors, ToFrameSlots>, is_rough, has_walls>{
                                   gather(NearNeighbors{world.neighbors(pass)}), world.near_records});
    } else {
      run.for_each_sphere(Stage::gather_contacts, world.count,
                          SharedFramePass<GatherContacts<FrameListNeighbors, ToFrameSlots>, is_rough, has_walls>{
                              gather(world.neighbors(pass))});
    }
    run.for_each(
        Stage::apply_contacts, world.count,
        SingleFramePass<ApplyContacts<Output>, is_rough, has_walls>{
            {{step, world.grid(), output, world.velocity_change, world.turn, world.pick, watch, world.memory.cleared},
             world.control,
             world.frame_of(pass)}});
    world.memory = world.memory.next();
  }
  world.swap_state();
}

template <bool is_rough, bool has_walls, class Run>
void simulate_frames_of_lists(Run& run, FrameWorld& world, std::uint32_t frames, bool is_last) {
  make_frame_lists<has_walls>(run, world, frames);
  const auto passes = frames * static_cast<std::uint32_t>(world.frame.iterations);
  for (std::uint32_t pass = 0; pass + 1 < passes; ++pass) {
    const bool ends_frame = world.frame_of(pass + 1) != world.frame_of(pass);
    if (ends_frame && world.frame.solver == Solver::reference) {
      run_pass<is_rough, has_walls>(run, world, pass, world.to_flying_slots(pass));
    } else {
      run_pass<is_rough, has_walls>(run, world, pass, world.to_slots(pass));
    }
  }
  run_pass<is_rough, has_walls>(run, world, passes - 1, world.to_next_frame(is_last));
}

// Asks goes_on(control) every 16 frames, and ends where it is false: fewer by an even number then, as what contacts
// remember is written to two copies in turn. Returns how many frames have been simulated.
template <bool is_rough, bool has_walls, class Run, class GoesOn>
std::int64_t simulate_frames_by_their_lists(Run& run, FrameWorld& world, std::int64_t frames, const GoesOn& goes_on) {
  ToNextFrame first = world.to_next_frame(false);
  first.to = world.state;
  run.for_each(Stage::load, world.count, LoadInto<ToNextFrame>{world.is_new, world.bodies, world.mass_ids, first});
  world.is_new = false;
  const auto simulate = [&](std::uint32_t some, bool is_last) {
    simulate_frames_of_lists<is_rough, has_walls>(run, world, some, is_last);
  };
  // What contacts remember from before the run is read by its first pass and no other: a frame that cannot be repeated.
  const std::int64_t alone = is_rough && frames > 1 ? 1 : 0;
  if (alone > 0) simulate(1, false);
  const std::int64_t spells = (frames - alone - 1) / world.frames_of_lists;
  // Few spheres, which lanes share, go on as they began.
  const bool is_watched = world.lists.lane_bits == 0;
  const std::int64_t most = is_watched ? frames_to_look / world.frames_of_lists : spells;
  std::int64_t done = alone;
  for (std::int64_t spell = 0; spell < spells; spell += most) {
    if (spell > 0) {
      const FrameControl found = run.read(world.control);
      if (!goes_on(found)) {
        frames = done + 2 - (frames - done) % 2;
        break;
      }
      choose_near_records(world, found.touched_samples);
    }
    const std::int64_t some = std::min(most, spells - spell);
    run.repeat(world, some, [&] { simulate(world.frames_of_lists, false); });
    done += some * world.frames_of_lists;
  }
  for (; done + world.frames_of_lists < frames; ++done) simulate(1, false);
  simulate(static_cast<std::uint32_t>(frames - done), true);
  run.for_each(Stage::store, world.count,
               StoreFrameBodies{{world.state, world.mass_ids, world.bodies},
                                world.control,
                                world.lists.rows << world.lists.lane_bits,
                                world.strays.places});
  return frames;
}

}  // namespace fastcollide
