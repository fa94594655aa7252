// The memory behind small_step.hpp on one backend, and the call that runs it.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>

#include "small_host_run.hpp"

namespace fastcollide {

// The page of a small world, for the memory of one block.
template <Solver solver, bool has_walls>
struct SimulateSmallWorld {
  SmallWorld world;

  FC_EITHER_SIDE
  template <class Run>
  FC_HOST_DEVICE void operator()(Run& run, unsigned char* memory, std::uint32_t owned) const {
    SmallWorld here = world;
    here.lay_out(memory, owned, run.blocks());
    here.lists.first = run.first();
    simulate_small_world<solver, has_walls>(run, here);
  }
};

template <Backend B>
class SmallRuns {
 public:
  explicit SmallRuns(B& backend) : backend_(backend), runner_(backend) {}

  // Whether a world fits into this form.
  bool has_room(const FrameParameters& frame, const BodyArrays& bodies, std::int64_t count) const {
    const bool is_rough = bodies.spins != nullptr && frame.solver == Solver::substep;
    return !is_rough && count <= most_entries && runner_.has_room(of(frame, bodies, count));
  }

  bool pays(std::int64_t count) const { return runner_.pays(count); }

  // Runs frames on the bodies, counted from 0 in what is told of them; after a fault the bodies are as before.
  Watch run(const FrameParameters& frame, std::int64_t frames, float largest_radius, const BodyArrays& bodies,
            std::int64_t count, StageTimer& timer);

 private:
  // Entries of lists are 16 bits.
  static constexpr std::int64_t most_entries = 65536;
  static constexpr std::uint32_t list_places = 96;
  // Lists hold for some frames: most of the time of these worlds is waiting, so that more neighbours cost little where
  // spheres are far apart.
  static constexpr float skin_frames = 8.0f, thinnest_skin = 0.25f, thickest_skin = 0.75f, thickest_in_spacing = 0.5f;

  static SmallWorld of(const FrameParameters& frame, const BodyArrays& bodies, std::int64_t count) {
    SmallWorld world{};
    world.frame = frame;
    world.count = static_cast<std::uint32_t>(count);
    world.bodies = bodies;
    world.places = list_places;
    return world;
  }

  static SkinLaw choose_skins(const FrameParameters& frame, float largest_radius, std::int64_t count) {
    const bool is_substep = frame.solver == Solver::substep;
    const Box& box = frame.substep.box;
    float thickest = thickest_skin * largest_radius;
    if (box.x != Boundary::open && box.y != Boundary::open && box.z != Boundary::open) {
      const double volume =
          double(box.upper.x - box.lower.x) * (box.upper.y - box.lower.y) * (box.upper.z - box.lower.z);
      const double spacing = std::cbrt(volume / static_cast<double>(count));
      thickest = std::max(thickest, thickest_in_spacing * static_cast<float>(spacing));
    }
    const float passes = is_substep ? static_cast<float>(frame.iterations) : 1.0f;
    return {skin_frames * passes * frame.substep.flight.dt, thinnest_skin * largest_radius, thickest,
            is_substep ? frame.substep.law.opening_margin : 0.0f, largest_radius};
  }

  template <bool has_walls>
  void start(const SmallWorld& world, StageTimer& timer) {
    if (world.frame.solver == Solver::reference) {
      runner_.run(SimulateSmallWorld<Solver::reference, has_walls>{world}, timer);
    } else {
      runner_.run(SimulateSmallWorld<Solver::substep, has_walls>{world}, timer);
    }
  }

  B& backend_;
  SmallRunner<B> runner_;
  typename B::template Buffer<Watch> watch_{backend_};
};

// Not in the class, as in level_runs.hpp.
template <Backend B>
Watch SmallRuns<B>::run(const FrameParameters& frame, std::int64_t frames, float largest_radius,
                        const BodyArrays& bodies, std::int64_t count, StageTimer& timer) {
  if (frames == 0 || count == 0) return {};
  SmallWorld world = of(frame, bodies, count);
  world.frames = static_cast<std::uint32_t>(frames);
  world.skin = choose_skins(frame, largest_radius, count);
  watch_.resize(1);
  Watch watch;
  backend_.copy_to_device(watch_.data(), &watch, 1);
  world.watch = watch_.data();
  const Box& box = frame.substep.box;
  const bool has_walls = box.x == Boundary::wall && box.y == Boundary::wall && box.z == Boundary::wall;
  has_walls ? start<true>(world, timer) : start<false>(world, timer);
  backend_.copy_to_host(&watch, std::as_const(watch_).data(), 1);
  return watch;
}

}  // namespace fastcollide
