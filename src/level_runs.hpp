// The memory behind level_step.hpp on one backend, and the call that runs it.
#pragma once

#include <algorithm>
#include <utility>

#include "contact_memory.hpp"
#include "grid_shape.hpp"
#include "level_stages.hpp"
#include "level_step.hpp"
#include "slot_buffers.hpp"

namespace fastcollide {

template <Backend B>
class LevelRuns {
 public:
  explicit LevelRuns(B& backend) : backend_(backend) {}

  // Runs frames on the bodies, counted from 0 in what is told of them; after a fault the bodies are as before.
  Watch run(const FrameParameters& frame, std::int64_t frames, const CellLevels& levels, const RadiusSurvey& radii,
            const BodyArrays& bodies, std::int64_t count, ContactMemory<B>& memory, StageTimer& timer);

 private:
  // Large spheres look at many rows of cells, most of them in finer levels.
  static SlotGroups group_levels(const CellLevels& levels, const RadiusSurvey& radii, std::int64_t count) {
    static_assert(SlotGroups::most >= most_levels);
    SlotGroups groups{};
    std::int64_t first = 0;
    for (int k = 0; k < levels.count; ++k) {
      std::int64_t members = 0;
      for (int octave = 0; octave < octaves; ++octave) {
        if (levels.level_of_octave[octave] == k) members += radii.octave_counts[octave];
      }
      double rows = 0;
      for (int m = 0; m < levels.count; ++m) {
        const float largest = levels.levels[k].largest_radius, other = levels.levels[m].largest_radius;
        const double across = 1.0 + 2.0 * (largest + other) * levels.levels[m].shape.y.inverse_edge;
        rows += across * across;
      }
      const int fewest_lanes = B::has_whole_grid && count <= 131072 ? 8 : 1;
      // Few of them should not keep the others waiting.
      const double parts = std::clamp(std::min(rows / 1024, 4096.0 / static_cast<double>(members + 1)), 1.0, 32.0);
      const int lanes = rows > 512 ? 128 * static_cast<int>(parts) : rows > 128 ? 32 : fewest_lanes;
      SlotGroup* last = groups.count > 0 ? &groups.groups[groups.count - 1] : nullptr;
      if (last != nullptr && last->lanes == lanes) {
        last->count += members;
      } else {
        groups.groups[groups.count++] = {first, members, lanes};
      }
      first += members;
    }
    return groups;
  }

  void resize(const LevelWorld& world) {
    const std::int64_t count = world.count, cells = world.cells;
    const bool is_rough = world.bodies.spins != nullptr, is_substep = world.frame.solver == Solver::substep;
    count_ = 0;  // nothing is known should memory run out on the way
    for (auto* state : {&state_, &other_state_}) state->resize(count, is_substep, is_rough);
    for (auto* mass_ids : {&mass_ids_, &other_mass_ids_}) mass_ids->resize(count);
    cell_of_slot_.resize(count);
    rank_of_slot_.resize(count);
    velocity_change_.resize(is_substep ? count : 0);
    pick_.resize(is_substep ? count : 0);
    turn_.resize(is_substep && is_rough ? count : 0);
    if (cell_counts_.size() < cells + 1) {
      cell_counts_.resize(cells + 1);
      backend_.fill_zero(cell_counts_.data(), cells + 1);
    }
    cell_start_.resize(cells + 1);
    watch_.resize(1);
    levels_.resize(1);
    count_ = count;
  }

  void set_pointers(LevelWorld& world) {
    world.state = state_.view();
    world.other_state = other_state_.view();
    world.mass_ids = mass_ids_.data();
    world.other_mass_ids = other_mass_ids_.data();
    world.cell_of_slot = cell_of_slot_.data();
    world.rank_of_slot = rank_of_slot_.data();
    world.cell_counts = cell_counts_.data();
    world.cell_start = cell_start_.data();
    world.velocity_change = velocity_change_.data();
    world.turn = turn_.size() > 0 ? turn_.data() : nullptr;
    world.pick = pick_.data();
    world.levels = levels_.data();
    world.watch = watch_.data();
  }

  B& backend_;
  SlotStateBuffers<B> state_{backend_}, other_state_{backend_};
  typename B::template Buffer<MassId> mass_ids_{backend_}, other_mass_ids_{backend_};
  typename B::template Buffer<std::uint32_t> cell_of_slot_{backend_}, rank_of_slot_{backend_}, cell_counts_{backend_},
      cell_start_{backend_}, pick_{backend_};
  typename B::template Buffer<Vec3> velocity_change_{backend_}, turn_{backend_};
  typename B::template Buffer<CellLevels> levels_{backend_};
  typename B::template Buffer<Watch> watch_{backend_};
  std::int64_t count_ = 0;  // of the spheres whose ids the slots hold
};

// Not in the class: what is defined there counts as inline, and step_cuda.cu, which only declares this instantiation,
// would compile all its kernels, too.
template <Backend B>
Watch LevelRuns<B>::run(const FrameParameters& frame, std::int64_t frames, const CellLevels& levels,
                        const RadiusSurvey& radii, const BodyArrays& bodies, std::int64_t count,
                        ContactMemory<B>& memory, StageTimer& timer) {
  if (frames == 0) return {};
  LevelWorld world{};
  world.frame = frame;
  world.count = count;
  world.is_new = count != count_;
  world.bodies = bodies;
  world.cells = levels.cells;
  world.groups = group_levels(levels, radii, count);
  resize(world);
  set_pointers(world);
  Watch watch;
  backend_.copy_to_device(watch_.data(), &watch, 1);
  backend_.copy_to_device(levels_.data(), &levels, 1);
  world.memory = memory.start_run(watch_.data(), frames * frame.iterations);
  LevelRun<B> run(backend_, timer);
  call_for_world(bodies.spins != nullptr, frame.substep.box, [&]<bool is_rough, bool has_walls>() {
    simulate_frames_by_levels<is_rough, has_walls>(run, world, static_cast<std::uint32_t>(frames));
  });
  // Which of the two copies holds what.
  if (world.mass_ids != mass_ids_.data()) std::swap(mass_ids_, other_mass_ids_);
  backend_.copy_to_host(&watch, std::as_const(watch_).data(), 1);
  return watch;
}

}  // namespace fastcollide
