// The memory behind listed_step.hpp on one backend, and the calls that run it.
#pragma once

#include <algorithm>
#include <optional>
#include <utility>

#include "contact_memory.hpp"
#include "grid_shape.hpp"
#include "host_run.hpp"
#include "listed_stages.hpp"
#include "slot_buffers.hpp"

namespace fastcollide {

// Lengths in the largest radius, time in frames. On an H200 half or double of each changed the frame of 20,000 and of
// 1,000,000 spheres by a sixth at most, but for a thinnest skin of 0.15 or 0.3: docs/performance.md.
inline constexpr float thickest_skin = 0.5f, skin_time = 1.1f, list_cell_edge = 1.5f;
// A CPU mends lists at more cost, and looks at what is in them at less.
template <Backend B>
inline constexpr float thinnest_skin = B::has_whole_grid ? 0.05f : 0.1f;

template <Backend B>
class ListedFrames {
 public:
  explicit ListedFrames(B& backend) : backend_(backend) {}

  // Runs frames on the bodies, counted from 0 in what is told of them; after a fault the bodies are as before, and also
  // where nothing is returned: some sphere has so many near it that lists are no way to keep them.
  // `may_have_changed`: someone else may have written to the bodies since the last call.
  std::optional<Watch> run(const FrameParameters& frame, std::int64_t frames, bool may_have_changed,
                           float largest_radius, const BodyArrays& bodies, std::int64_t count, ContactMemory<B>& memory,
                           StageTimer& timer) {
    if (count == crowded_count_) return {};
    const bool is_new = count != count_;
    choose_lanes(count);
    const float reach = frame.solver == Solver::substep ? frame.substep.law.opening_margin : 0.0f;
    ListedWorld world{};
    world.frame = frame;
    world.frames = static_cast<std::uint32_t>(frames);
    world.is_new = is_new;
    world.must_load = is_new || may_have_changed;
    world.bodies = bodies;
    world.count = count;
    // Cells smaller than a sphere: a search looks at no more of them than it needs.
    world.shape = choose_grid_shape(frame.substep.box, 0.5f * list_cell_edge * largest_radius, 0.0f, count, 0.0f);
    const float passes = frame.solver == Solver::substep ? static_cast<float>(frame.iterations) : 1.0f;
    world.skin = {skin_time * passes * frame.substep.flight.dt, thinnest_skin<B> * largest_radius,
                  thickest_skin * largest_radius, reach, largest_radius};
    resize(world, bodies.spins != nullptr, frame.solver == Solver::substep);
    control_.watch = {};
    control_.frame = control_.pass = 0;
    world.memory = memory.start_run(&device_control_.data()->watch, frames * frame.iterations);

    for (;;) {
      run_once(world, timer);
      if (control_.longest > capacity_ && !grow_lists()) return {};
      if (control_.watch.first_fault != no_fault || control_.frame == world.frames) return control_.watch;
      world.is_new = world.must_load = false;
    }
  }

 private:
  void run_once(ListedWorld& world, StageTimer& timer) {
    set_pointers(world);
    backend_.copy_to_device(device_control_.data(), &control_, 1);
    if (world.frame.solver == Solver::reference) {
      start(SimulateListedFrames<Solver::reference>{world}, timer);
    } else {
      start(SimulateListedFrames<Solver::substep>{world}, timer);
    }
    backend_.copy_to_host(&control_, std::as_const(device_control_).data(), 1);
    if (control_.state_swaps % 2 == 1) std::swap(state_, other_state_);
    if (control_.sorts % 2 == 1) std::swap(mass_ids_, other_mass_ids_);
  }

  // On a GPU, one kernel for all frames; where the work of a stage is long beside a launch, a kernel for each stage,
  // which needs fewer registers and so keeps more threads waiting for memory at the same time.
  template <class Program>
  void start(const Program& program, StageTimer& timer) {
    if constexpr (B::has_whole_grid) {
      switch (lanes_) {
        case 8:
          return backend_.template run_on_whole_grid<8>(count_, program, timer);
        case 2:
          return backend_.template run_on_whole_grid<2>(count_, program, timer);
        default:
          break;
      }
    }
    ListedRun<B> run(backend_, timer, stages_);
    program(run);
  }

  // Several lanes for each sphere where a GPU has more threads than there are spheres. Lists are made for a number of
  // lanes.
  void choose_lanes(std::int64_t count) {
    std::uint32_t lanes = 1;
    if constexpr (B::has_whole_grid) lanes = count <= 4096 ? 8 : count <= 400000 ? 2 : 1;
    if (lanes == lanes_) return;
    lanes_ = lanes;
    capacity_ = lanes == 1 ? 16 : lanes == 2 ? 12 : 8;
    control_.news[0].is_stale = control_.news[1].is_stale = 1;
  }
  std::int64_t list_places(std::int64_t count) const {
    const std::int64_t rows = count * lanes_, width = B::list_width;
    return (rows + width - 1) / width * width * capacity_;
  }

  void resize(ListedWorld& world, bool is_rough, bool has_crowding) {
    const std::int64_t count = world.count;
    count_ = 0;  // nothing is known should memory run out on the way
    for (auto* state : {&state_, &other_state_}) state->resize(count, has_crowding, is_rough);
    for (auto* mass_ids : {&mass_ids_, &other_mass_ids_}) mass_ids->resize(count);
    for (auto* buffer : {&cell_of_slot_, &rank_of_slot_, &sorted_cells_}) buffer->resize(count);
    queue_places_ = static_cast<std::uint32_t>(std::max<std::int64_t>(count / 16, 256));
    queues_.resize(2 * std::int64_t(queue_places_));
    built_.resize(count);
    velocity_change_.resize(has_crowding ? count : 0);
    pick_.resize(has_crowding ? count : 0);
    turn_.resize(has_crowding && is_rough ? count : 0);
    world.cells = std::int64_t(world.shape.x.cells) * world.shape.y.cells * world.shape.z.cells;
    if (cell_counts_.size() < world.cells + 1) {
      cell_counts_.resize(world.cells + 1);
      backend_.fill_zero(cell_counts_.data(), world.cells + 1);
    }
    cell_start_.resize(world.cells + 1);
    device_control_.resize(1);
    list_counts_.resize(count * lanes_);
    list_entries_.resize(list_places(count));
    stages_.resize(count);
    count_ = count;
  }

  bool grow_lists() {
    capacity_ = (control_.longest + control_.longest / 4 + 7) / 8 * 8;
    control_.longest = 0;
    control_.news[0].is_stale = control_.news[1].is_stale = 1;
    if (list_places(count_) > std::max(most_places, most_places_each * count_)) {
      crowded_count_ = count_;
      count_ = 0;
      lanes_ = 0;
      list_entries_ = typename B::template Buffer<std::uint32_t>(backend_);
      return false;
    }
    list_entries_.resize(list_places(count_));
    return true;
  }

  void set_pointers(ListedWorld& world) {
    world.state = state_.view();
    world.other_state = other_state_.view();
    world.mass_ids = mass_ids_.data();
    world.other_mass_ids = other_mass_ids_.data();
    world.built = built_.data();
    world.cell_of_slot = cell_of_slot_.data();
    world.rank_of_slot = rank_of_slot_.data();
    world.sorted_cells = sorted_cells_.data();
    world.queues = queues_.data();
    world.queue_places = queue_places_;
    world.cell_counts = cell_counts_.data();
    world.cell_start = cell_start_.data();
    world.lists = {list_entries_.data(), list_counts_.data(), capacity_, B::list_width, lanes_};
    world.velocity_change = velocity_change_.data();
    world.turn = turn_.size() > 0 ? turn_.data() : nullptr;
    world.pick = pick_.data();
    world.control = device_control_.data();
  }

  // Of all lists together.
  static constexpr std::int64_t most_places = std::int64_t(1) << 24, most_places_each = 512;

  B& backend_;
  std::int64_t count_ = 0;
  std::int64_t crowded_count_ = -1;  // of the spheres that lists could not keep
  std::uint32_t lanes_ = 0, capacity_ = 0, queue_places_ = 0;
  ListControl control_{};  // as the device left it
  typename B::template Buffer<ListControl> device_control_{backend_};
  ListedStages<B> stages_{backend_};
  SlotStateBuffers<B> state_{backend_}, other_state_{backend_};
  typename B::template Buffer<MassId> mass_ids_{backend_}, other_mass_ids_{backend_};
  typename B::template Buffer<Vec4> built_{backend_};
  typename B::template Buffer<ListCount> list_counts_{backend_};
  typename B::template Buffer<Vec3> velocity_change_{backend_}, turn_{backend_};
  typename B::template Buffer<std::uint32_t> cell_of_slot_{backend_}, rank_of_slot_{backend_}, sorted_cells_{backend_},
      cell_counts_{backend_}, cell_start_{backend_}, pick_{backend_}, list_entries_{backend_};
  typename B::template Buffer<QueuedSphere> queues_{backend_};
};

}  // namespace fastcollide
