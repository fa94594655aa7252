// The memory behind frame_step.hpp on one backend, and the calls that run it.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "contact_memory.hpp"
#include "frame_step.hpp"
#include "grid_shape.hpp"
#include "host_run.hpp"
#include "slot_buffers.hpp"

namespace fastcollide {

template <Backend B>
class FrameRuns {
 public:
  explicit FrameRuns(B& backend) : backend_(backend) {}

  // Runs frames on the bodies, counted from 0 in what is told of them, or the first of them where spheres begin to pile
  // up; after a fault the bodies are as before, and also where nothing is returned: some sphere has so many near it
  // that lists are no way to keep them.
  std::optional<RunResult> run(const FrameParameters& frame, std::int64_t frames, float largest_radius,
                               const BodyArrays& bodies, std::int64_t count, ContactMemory<B>& memory,
                               StageTimer& timer) {
    if (frames == 0) return RunResult{};
    if (count == crowded_count_) return {};
    FrameWorld world{};
    world.frame = frame;
    world.is_new = count != count_;
    world.bodies = bodies;
    world.count = count;
    const bool is_substep = frame.solver == Solver::substep;
    const bool is_rough = is_substep && bodies.spins != nullptr;  // the report's loop does not turn spheres
    world.shape = shape_cells(frame.substep.box, largest_radius, count);
    const float reach = is_substep ? frame.substep.law.opening_margin : 0.0f;
    const float dt =
        frame.substep.flight.dt * (is_substep ? static_cast<float>(frame.iterations) : 1.0f);  // of a frame
    world.frames_of_lists = choose_frames_of_lists(largest_radius / dt, count, frames);
    const Skins skins = skins_for(count, world.frames_of_lists);
    const float thickest = skins.thickest * largest_radius;
    world.skin = {skin_time * static_cast<float>(world.frames_of_lists) * dt, skins.thinnest * largest_radius, thickest,
                  reach, largest_radius};
    world.drift = {samples_of(count), static_cast<std::uint32_t>(count / samples_of(count)),
                   skins_for(count, most_frames_of_lists).thickest * largest_radius / (most_frames_of_lists * dt)};
    world.shares_pairs = is_rough && (count <= always_share_pairs || was_dense(count));
    world.strays.coarse = choose_grid_shape(frame.substep.box, 2.0f * largest_radius, 0.0f, count / 4, 0.0f);
    world.strays.passes = static_cast<std::uint32_t>(frame.iterations);
    choose_lanes(count);
    const bool may_find_near = is_substep && !are_few(count);
    for (;;) {
      resize(world, is_substep, is_rough);
      resize_near_records(may_find_near ? count : 0);
      set_pointers(world);
      choose_near_records(world, touched_samples_);
      world.memory = memory.start_run(&control_.data()->watch, frames * frame.iterations).of_pass(0);
      const auto [control, done] = run_once(world, frames, timer);
      count_ = count;
      make_room(control, done);
      last_strays_ = stray_records_of(control);
      last_void_lists_ = control.void_lists / done;
      mean_speed_ = control.mean_speed;
      fast_samples_ = control.fast_samples;
      touched_samples_ = control.touched_samples;
      if (had_room(world, control)) return RunResult{control.watch, done};
      if (count == crowded_count_) return {};
      world.is_new = false;
    }
  }

  // Whether in the last frames so many spheres left their skins, or had no room in their lists, that to search took
  // most of the time.
  bool had_to_search() const { return has_to_search(last_strays_, last_void_lists_, count_); }

 private:
  static bool has_to_search(std::int64_t strays, std::int64_t void_lists, std::int64_t count) {
    return strays > count / 8 || void_lists > count / 64;
  }
  static std::int64_t stray_records_of(const FrameControl& control) {
    return *std::max_element(std::begin(control.stray_records), std::end(control.stray_records));
  }
  static bool had_room(const FrameWorld& world, const FrameControl& control) {
    return control.longest <= world.lists.places() && control.most_stray_records <= world.strays.places;
  }

  // A search looks at runs of cells along x: narrow there, so that it looks at little else, and wide across, so that
  // it begins few runs. Of few spheres they are larger, so that there are about four cells for each.
  static GridShape shape_cells(const Box& box, float largest_radius, std::int64_t count) {
    double edge = static_cast<double>(largest_radius);
    if (box.x != Boundary::open && box.y != Boundary::open && box.z != Boundary::open) {
      const double volume =
          double(box.upper.x - box.lower.x) * (box.upper.y - box.lower.y) * (box.upper.z - box.lower.z);
      edge = std::max(edge, std::cbrt(0.12 * volume / static_cast<double>(count)));
    }
    const auto cells = [&](const Box& within, double width) {
      return choose_grid_shape(within, static_cast<float>(0.5 * width * edge), 0.0f, 16 * count, 0.0f);
    };
    const CellEdges& edges = lane_bits_for(count) == 3 ? edges_of_few : are_few(count) ? edges_of_some : edges_of_many;
    const GridShape wide = cells(box, edges.wide);
    // One row of them where x has ends, as a whole grid of narrow ones may be too large.
    Box row = box;
    if (box.x != Boundary::open) {
      row.y = row.z = Boundary::wall;
      row.lower.y = row.lower.z = 0.0f;
      row.upper.y = row.upper.z = largest_radius;
    }
    const GridShape narrow = cells(row, edges.narrow);
    return {narrow.x, wide.y, wide.z};
  }

  // Skins, in the largest radius, and how many frames at its speed a sphere may move. Where a GPU has threads to spare,
  // a stray takes longer than looking at more neighbours; of many spheres, looking is what takes time. On an H100 half
  // of each cost up to a third with 20,000 spheres, twice as much a tenth.
  static constexpr float skin_time = 1.0f;
  struct Skins {
    float thinnest, thickest;
  };
  // Spheres in flight leave thin ones when others push them: 5,000 and 10,000 took 5 to 8 % less with 0.35 and 1 than
  // with 0.25 and 0.75; where they lie, 5,000 took 3 % more with the default solver.
  static Skins skins_for(std::int64_t count, std::uint32_t frames_of_lists) {
    if (!are_few(count)) return {0.15f, 0.5f};
    return lane_bits_for(count) == 3 && frames_of_lists == 1 ? Skins{0.35f, 1.0f} : Skins{0.25f, 0.75f};
  }
  static constexpr std::int64_t few = 131072;
  static bool are_few(std::int64_t count) { return lane_bits_for(count) > 0; }
  // Of cells, in the largest radius. Where eight lanes share a sphere, narrower ones gained nothing.
  struct CellEdges {
    double narrow, wide;
  };
  static constexpr CellEdges edges_of_few{1.0, 2.25}, edges_of_some{0.5, 2.4}, edges_of_many{0.6, 2.8};
  // More have to look through the grid alone. On an H100, ms with none, 1,024 and 8,192: 200,000 spheres of the
  // report's loop 0.226, 0.171, 0.177; 1,000,000 as they land 1.72, 1.68, 1.54. Where eight lanes share a sphere, and
  // the default solver, gained nothing.
  static std::int64_t helped_strays_of(std::int64_t count, bool is_substep) {
    if (is_substep || lane_bits_for(count) == 3) return 0;
    return B::has_whole_grid ? std::clamp<std::int64_t>(count / 256, 1024, 8192) : 64;
  }
  // They all add to the same words, one after the other: a thousand take more than two microseconds.
  static std::uint32_t samples_of(std::int64_t count) {
    return static_cast<std::uint32_t>(std::min<std::int64_t>(count, are_few(count) ? 128 : 1024));
  }

  // Of more rough spheres, lanes share the pairs of their warp only where most are touched. On an H100 that took 40,000
  // in flight from 0.297 to 0.25 ms, 100,000 from 0.295 to 0.305.
  static constexpr std::int64_t always_share_pairs = 65536;
  // Whether others touched most of the spheres when the last run ended.
  bool was_dense(std::int64_t count) const {
    const std::uint32_t samples = samples_of(count);
    return touched_samples_ <= samples && 2 * touched_samples_ > samples;
  }

  // As many as most spheres, as fast as in the last run, take to move by a part of the largest radius. In flight skins
  // for two frames have more strays than the lists that they save are worth; in a pile hardly anything leaves its skin.
  // On an H100, 20,000 landed spheres: lists of one frame 0.120 ms, of two 0.105, of four or eight no less.
  static constexpr std::uint32_t most_frames_of_lists = 4;
  std::uint32_t choose_frames_of_lists(float radius_per_frame, std::int64_t count, std::int64_t most) const {
    if (128 * std::int64_t(fast_samples_) > samples_of(count)) return 1;
    std::uint32_t frames = 1;
    while (2 * frames <= std::min<std::int64_t>(most, most_frames_of_lists) &&
           static_cast<float>(2 * frames) * mean_speed_ < 0.08f * radius_per_frame) {
      frames *= 2;
    }
    return frames;
  }

  // What the device has told, and how many frames it has simulated.
  std::pair<FrameControl, std::int64_t> run_once(const FrameWorld& world, std::int64_t frames, StageTimer& timer) {
    FrameControl control{};
    control.next_drift = drift_;
    control.touched_samples = touched_samples_;
    backend_.copy_to_device(control_.data(), &control, 1);
    backend_.fill_zero(stray_words_.data(), stray_words_.size());
    FrameWorld running = world;
    auto run = runner_.run(backend_, timer, 1u << lane_bits_, world.shares_pairs);
    std::uint32_t void_lists = 0;
    const auto goes_on = [&](const FrameControl& found) {
      const std::int64_t new_void_lists = found.void_lists - std::exchange(void_lists, found.void_lists);
      return found.watch.first_fault == no_fault && found.watch.memory_wanted.now == 0 && had_room(world, found) &&
             !has_to_search(stray_records_of(found), new_void_lists / frames_to_look, world.count);
    };
    std::int64_t done = 0;
    call_for_world(world.state.spins != nullptr, world.frame.substep.box, [&]<bool is_rough, bool has_walls>() {
      done = simulate_frames_by_their_lists<is_rough, has_walls>(run, running, frames, goes_on);
    });
    // Which of the two copies holds what.
    if (running.mass_ids != world.mass_ids) std::swap(mass_ids_, other_mass_ids_);
    backend_.copy_to_host(&control, std::as_const(control_).data(), 1);
    drift_ = control.next_drift;
    return {control, done};
  }

  static std::uint32_t lane_bits_for(std::int64_t count) {
    if (!B::has_whole_grid) return 0;
    return count <= 32768 ? 3 : count <= few ? 2 : 0;
  }
  // Else a cell ends where the next one begins.
  bool takes_cells_in_blocks() const { return lane_bits_ == 3; }
  void choose_lanes(std::int64_t count) {
    const std::uint32_t bits = lane_bits_for(count);
    if (bits == lane_bits_ && rows_ > 0) return;
    lane_bits_ = bits;
    may_grow_ = true;
    // Few spheres get long lists at once; of many, most lie in open space at the start.
    rows_ = needed_rows_ = (count <= few ? 96u : FrameLists::rows_of_many) >> bits;
  }

  void resize(FrameWorld& world, bool is_substep, bool is_rough) {
    const std::int64_t count = world.count;
    count_ = 0;  // nothing is known should memory run out on the way
    for (auto* state : {&state_, &other_state_}) state->resize(count, is_substep, is_rough);
    for (auto* mass_ids : {&mass_ids_, &other_mass_ids_}) mass_ids->resize(count);
    built_.resize(count);
    cell_of_slot_.resize(count);
    velocity_change_.resize(is_substep ? count : 0);
    turn_.resize(is_rough ? count : 0);
    pick_.resize(is_substep ? count : 0);
    world.cells = std::int64_t(world.shape.x.cells) * world.shape.y.cells * world.shape.z.cells;
    if (cell_counts_.size() < world.cells + 1) {
      cell_counts_.resize(world.cells + 1);
      backend_.fill_zero(cell_counts_.data(), world.cells + 1);
    }
    cell_start_.resize(world.cells + 1);
    cell_end_.resize(takes_cells_in_blocks() ? world.cells + 1 : 0);
    control_.resize(1);
    list_counts_.resize(count);
    resize_lists(count);
    if (lane_bits_ == 0) {
      chunks_ = std::max(chunks_, count / 16);
      chunk_of_slot_.resize(count);
      resize_anew(chunk_entries_, chunks_ * FrameLists::chunk_places);
    }
    const GridShape& coarse = world.strays.coarse;
    // Where many pile up each may be a stray, some with two records, and more room later means to run the frames again.
    const std::int64_t strays = are_few(count) ? count / 8 : count <= 128 * few ? 2 * count : count / 2;
    stray_places_ = std::max<std::uint32_t>(stray_places_, static_cast<std::uint32_t>(1024 + strays));
    stray_heads_ = std::int64_t(coarse.x.cells) * coarse.y.cells * coarse.z.cells;
    helped_strays_ = helped_strays_of(count, is_substep);
    resize_anew(stray_words_, 2 * stray_heads_ + helped_strays_ + Strays::region_count(coarse));
    for (auto& records : stray_records_) resize_anew(records, stray_places_);
  }
  // Of one whose contents nobody needs: they are not copied where it grows.
  template <class Buffer>
  void resize_anew(Buffer& buffer, std::int64_t count) {
    if (buffer.size() < count) buffer = Buffer(backend_);
    buffer.resize(count);
  }
  // Records are a wish: where memory has no room for them, contact passes take all spheres.
  void resize_near_records(std::int64_t count) {
    try {
      near_records_.resize(count);
    } catch (const OutOfMemory&) {
      near_records_.resize(0);
    }
  }
  // Longer lists are a wish: where memory has no room for them, they stay as long as they were.
  void resize_lists(std::int64_t count) {
    const std::int64_t before = list_entries_.size();
    try {
      list_entries_.resize(list_places(count));
    } catch (const OutOfMemory&) {
      if (rows_ <= needed_rows_) throw;
      rows_ = needed_rows_;
      may_grow_ = false;
      list_entries_.resize(list_places(count));
    }
    needed_rows_ = rows_;
    // Passes ask for entries before they know whether there are any.
    if (list_entries_.size() != before) backend_.fill_zero(list_entries_.data(), list_entries_.size());
  }
  std::int64_t list_places(std::int64_t count) const {
    const std::int64_t width = B::list_width;
    return ((count << lane_bits_) + width - 1) / width * width * rows_;
  }

  // What a pass had no room for must have it; lists that are void now and then may stay so. Where many are, and longer
  // ones would take too much memory, this form is no way to run the world.
  void make_room(const FrameControl& control, std::int64_t frames) {
    const std::uint32_t needed = (control.longest + (1u << lane_bits_) - 1) >> lane_bits_;
    std::uint32_t rows = std::max(rows_, needed);
    const std::int64_t void_lists = control.void_lists / frames;
    const bool had_chunks = control.most_chunks <= chunks_;
    if (!had_chunks) chunks_ = control.most_chunks + control.most_chunks / 2;
    const bool may_wish = had_chunks && may_grow_ && 4 * list_places(count_) < most_wished_bytes;
    if (may_wish && void_lists > count_ / 16384) rows = std::max(rows, rows_ + rows_ / 2 + 1);
    stray_places_ = std::max(stray_places_, control.most_stray_records + control.most_stray_records / 2);
    if (rows == rows_) return;
    if (count_ * (std::int64_t(rows) << lane_bits_) > std::max(most_places, most_places_each * count_)) {
      if (needed <= rows_ && void_lists < count_ / 16) return;
      crowded_count_ = count_;
      count_ = 0;
      rows = 0;
    }
    needed_rows_ = std::max(rows_, needed);
    rows_ = rows;
    list_entries_ = typename B::template Buffer<std::uint32_t>(backend_);  // to be made anew; nothing is kept in it
  }

  void set_pointers(FrameWorld& world) {
    world.state = state_.view();
    world.other_state = other_state_.view();
    world.mass_ids = mass_ids_.data();
    world.other_mass_ids = other_mass_ids_.data();
    world.built = built_.data();
    world.cell_of_slot = cell_of_slot_.data();
    world.cell_counts = cell_counts_.data();
    world.cell_start = cell_start_.data();
    world.cell_end = takes_cells_in_blocks() ? cell_end_.data() : cell_start_.data() + 1;
    world.lists = {list_entries_.data(),
                   list_counts_.data(),
                   rows_,
                   lane_bits_,
                   B::list_width == 1 ? 0u : 5u,
                   chunk_of_slot_.data(),
                   chunk_entries_.data(),
                   lane_bits_ == 0 ? static_cast<std::uint32_t>(chunks_) : 0};
    world.strays.places = stray_places_;
    std::uint64_t* heads = stray_words_.data();
    world.strays.helped = heads + 2 * stray_heads_;
    world.strays.helped_places = static_cast<std::uint32_t>(helped_strays_);
    auto* regions = reinterpret_cast<std::uint32_t*>(world.strays.helped + helped_strays_);
    world.strays.control = control_.data();
    world.other_strays = world.strays;
    for (int i = 0; i < 2; ++i) {
      Strays& strays = i == 0 ? world.strays : world.other_strays;
      strays.heads = heads + i * stray_heads_;
      strays.regions = regions + i * Strays::region_count(strays.coarse);
      strays.records = stray_records_[i].data();
    }
    world.velocity_change = velocity_change_.data();
    world.turn = turn_.size() > 0 ? turn_.data() : nullptr;
    world.pick = pick_.data();
    world.room_for_records = near_records_.size() > 0 ? near_records_.data() : nullptr;
    world.control = control_.data();
  }

  // Of all lists together.
  static constexpr std::int64_t most_places = std::int64_t(1) << 24, most_places_each = 128,
                                most_wished_bytes = std::int64_t(1) << 34;

  B& backend_;
  FrameRunner<B> runner_;
  std::int64_t count_ = 0;
  std::int64_t last_strays_ = 0, last_void_lists_ = 0;         // of a frame; strays as records
  Vec3 drift_{0, 0, 0};                                        // mean velocity of the last frame [m/s]
  float mean_speed_ = std::numeric_limits<float>::infinity();  // beside it [m/s]
  std::uint32_t fast_samples_ = 0;
  std::uint32_t touched_samples_ = std::numeric_limits<std::uint32_t>::max();
  std::int64_t crowded_count_ = -1;  // of the spheres that lists could not keep
  std::uint32_t lane_bits_ = 0, stray_places_ = 0;
  std::uint32_t rows_ = 0, needed_rows_ = 0;  // of the lists; without which frames cannot be run
  std::int64_t chunks_ = 0;                   // for lists that are too long for their rows
  bool may_grow_ = true;
  typename B::template Buffer<FrameControl> control_{backend_};
  SlotStateBuffers<B> state_{backend_}, other_state_{backend_};
  typename B::template Buffer<MassId> mass_ids_{backend_}, other_mass_ids_{backend_};
  typename B::template Buffer<Vec4> built_{backend_};
  typename B::template Buffer<Vec3> velocity_change_{backend_}, turn_{backend_};
  typename B::template Buffer<std::uint32_t> cell_of_slot_{backend_}, cell_counts_{backend_}, cell_start_{backend_},
      cell_end_{backend_}, pick_{backend_}, list_entries_{backend_}, list_counts_{backend_}, chunk_of_slot_{backend_},
      chunk_entries_{backend_};
  typename B::template Buffer<NearRecord> near_records_{backend_};
  std::int64_t stray_heads_ = 0, helped_strays_ = 0;                  // in each of the two tables, in both
  typename B::template Buffer<std::uint64_t> stray_words_{backend_};  // of the tables, and of the strays that get help
  typename B::template Buffer<StrayRecord> stray_records_[2]{typename B::template Buffer<StrayRecord>(backend_),
                                                             typename B::template Buffer<StrayRecord>(backend_)};
};

}  // namespace fastcollide
