// Frames of a world, without friction and spin, so small that one multiprocessor can hold it: the same results as
// step.hpp. Each of a few blocks that work together has a copy of all spheres and does the work on its own part of
// them; at the end of a stage it sends what it has written of that part to the others. On a GPU the copies lie in
// shared memory and all frames of a call are one kernel (backend/cluster_run.cuh); on a CPU there is one copy.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "frame_parameters.hpp"
#include "stage_timer.hpp"
#include "stages/apply_contacts.hpp"
#include "stages/gather_contacts.hpp"
#include "stages/known_world.hpp"
#include "stages/small_lists.hpp"
#include "stages/sort_slots.hpp"

namespace fastcollide {

struct SmallWorld {
  FrameParameters frame;
  std::uint32_t count, frames;
  BodyArrays bodies;
  SkinLaw skin;
  std::uint32_t places;  // in a list
  Watch* watch;

  // In the memory of a block: see lay_out().
  SlotState state, other_state;
  MassId* mass_ids;
  Vec3* velocity_change;
  std::uint32_t* pick;
  SmallLists lists;
  SmallNews* news;  // of all blocks: three in turn, that a pass reads, that it writes, and that the next one will write

  FC_HOST_DEVICE GridView grid() const { return view_of(state, mass_ids, count, period_of(frame.substep.box)); }
  FC_HOST_DEVICE ToSmallSlots to_slots(bool ends_frame, SmallNews* news_of_block) const {
    const Substep& step = frame.substep;
    return {other_state,
            period_of(step.box),
            lists.balls,
            news_of_block,
            {step.flight, step.box, step.wall, step.frame + 1, watch},
            frame.solver == Solver::reference && ends_frame && step.frame + 1 < frames};
  }

  FC_HOST_DEVICE void swap_state() {
    const SlotState before = state;
    state = other_state;
    other_state = before;
  }

  // Gives each array its part of a block's memory, which begins at a multiple of 16. Returns how many bytes they take:
  // all that is asked for where there is no memory yet. owned: spheres of a block, a multiple of 4.
  FC_HOST_DEVICE std::size_t lay_out(unsigned char* memory, std::uint32_t owned, std::uint32_t blocks) {
    std::size_t used = 0;
    const auto take = [&](auto*& array, std::size_t wanted) {
      array =
          reinterpret_cast<std::remove_reference_t<decltype(array)>>(reinterpret_cast<std::uintptr_t>(memory) + used);
      used += (wanted * sizeof *array + 15) / 16 * 16;
    };
    for (SlotState* copy : {&state, &other_state}) {
      *copy = {};
      take(copy->position_radius, count);
      take(copy->velocity_restitution, count);
      if (bodies.crowding != nullptr) take(copy->crowding, count);
    }
    take(mass_ids, count);
    if (frame.solver == Solver::substep) {
      take(velocity_change, count);
      take(pick, count);
    }
    take(lists.balls, count);
    take(lists.counts, owned);
    take(lists.entries, std::size_t(owned) * places);
    lists.places = places;
    take(news, 3 * blocks);
    return used;
  }
};

// What blocks send each other. send(array): the part of it that the block owns; send.news(all): its own.
struct SendState {
  SlotState state;
  SmallNews* news;  // of all blocks

  template <class Send>
  FC_HOST_DEVICE void operator()(const Send& send) const {
    send(state.position_radius);
    send(state.velocity_restitution);
    send.news(news);
  }
};

struct SendAll {
  SlotState state;
  MassId* mass_ids;

  template <class Send>
  FC_HOST_DEVICE void operator()(const Send& send) const {
    send(state.position_radius);
    send(state.velocity_restitution);
    if (state.crowding != nullptr) send(state.crowding);
    send(mass_ids);
  }
};

struct SendGathered {
  float* crowding;
  Vec3* velocity_change;
  std::uint32_t* pick;

  template <class Send>
  FC_HOST_DEVICE void operator()(const Send& send) const {
    send(crowding);
    send(velocity_change);
    send(pick);
  }
};

template <bool has_walls, class Run>
FC_HOST_DEVICE void make_small_lists(Run& run, const SmallWorld& world) {
  run.for_all(Stage::make_lists, world.count, BeginSmallLists{world.state, world.skin, world.lists, run.owned()});
  RecordSmallLists record{world.mass_ids, world.count, period_of(world.frame.substep.box), world.skin.reach,
                          world.lists};
  if constexpr (has_walls) record.assume_walls();
  run.for_own_shared(Stage::make_lists, record);
}

// One iteration of the reference solver, one substep of the default one. news: what blocks tell each other after it.
template <Solver solver, bool has_walls, class Run>
FC_HOST_DEVICE void run_small_pass(Run& run, SmallWorld& world, bool ends_frame, SmallNews* news) {
  const Substep& step = world.frame.substep;
  const SmallNeighbors neighbors{world.lists};
  const ToSmallSlots output = world.to_slots(ends_frame, news + run.block());
  const SendState send{world.other_state, news};
  const auto known = [](auto pass) { return in_known_world<false, has_walls>(pass); };
  if constexpr (solver == Solver::reference) {
    run.for_each_sphere(
        Stage::solve_contacts,
        known(SolveContacts<SmallNeighbors, ToSmallSlots>{world.frame.scales, step.box, step.frame, world.grid(),
                                                          neighbors, output, &world.watch->first_fault}),
        send);
  } else {
    run.for_each_sphere(
        Stage::gather_contacts,
        known(GatherContacts<SmallNeighbors, ToSmallSlots>{step, world.grid(), neighbors, output, world.velocity_change,
                                                           nullptr, world.pick, &world.watch->first_fault}),
        SendGathered{output.to.crowding, world.velocity_change, world.pick});
    run.for_each(Stage::apply_contacts,
                 known(ApplyContacts<ToSmallSlots>{step, world.grid(), output, world.velocity_change, nullptr,
                                                   world.pick, world.watch}),
                 send);
  }
  world.swap_state();
}

template <Solver solver, bool has_walls, class Run>
FC_HOST_DEVICE void simulate_small_world(Run& run, SmallWorld& world) {
  std::uint32_t& frame = world.frame.substep.frame;
  frame = ~std::uint32_t(0);  // one before 0
  ToSmallSlots first = world.to_slots(true, nullptr);
  first.to = world.state;
  run.alone([&] {
    for (std::uint32_t i = 0; i < 3 * run.blocks(); ++i) world.news[i].is_stale = i < run.blocks() ? 1 : 0;
  });
  run.for_each(Stage::load, LoadInto<ToSmallSlots>{true, world.bodies, world.mass_ids, first},
               SendAll{world.state, world.mass_ids});
  SmallNews *now = world.news, *next = now + run.blocks(), *after = next + run.blocks();
  for (frame = 0; frame < world.frames; ++frame) {
    for (int i = 0; i < world.frame.iterations; ++i) {
      if (run.any_is_stale(now)) make_small_lists<has_walls>(run, world);
      run.alone([&] { after[run.block()].is_stale = 0; });
      run_small_pass<solver, has_walls>(run, world, i + 1 == world.frame.iterations, next);
      SmallNews* before = now;
      now = next;
      next = after;
      after = before;
    }
  }
  run.wait_for_memory();
  if (run.read(&world.watch->first_fault) != no_fault) return;  // bodies stay as they were
  run.for_own(Stage::store, StoreBodies{world.state, world.mass_ids, world.bodies});
}

}  // namespace fastcollide
