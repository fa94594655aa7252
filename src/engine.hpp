// A world on one backend, behind an interface that knows none.
#pragma once

#include <chrono>
#include <cmath>
#include <limits>
#include <mutex>
#include <optional>
#include <utility>

#include "fastcollide/devices.hpp"
#include "fastcollide/renderer.hpp"
#include "fastcollide/world.hpp"
#include "frame_runs.hpp"
#include "grid_shape.hpp"
#include "level_runs.hpp"
#include "listed_frames.hpp"
#include "small_runs.hpp"
#include "stages/check_state.hpp"
#include "stages/measure_contacts.hpp"
#include "stages/random_start.hpp"
#include "step.hpp"

namespace fastcollide {

// Simulated time as a product, not as a sum of many small steps: 300 frames of 1/60 s are 5 s.
class Clock {
 public:
  Clock() = default;
  explicit Clock(const WorldState& state)
      : frame_(state.frame), start_frame_(state.start_frame), start_(state.start_time), dt_(state.dt) {}
  void save(WorldState& state) const {
    state.frame = frame_;
    state.start_frame = start_frame_;
    state.start_time = start_;
    state.dt = dt_;
  }

  std::int64_t frame() const { return frame_; }
  double dt() const { return dt_; }  // of the last frame [s]
  double time() const { return start_ + static_cast<double>(frame_ - start_frame_) * dt_; }
  void advance(std::int64_t frames, double dt) {
    if (dt != dt_) {
      start_ = time();
      start_frame_ = frame_;
      dt_ = dt;
    }
    frame_ += frames;
  }

 private:
  std::int64_t frame_ = 0, start_frame_ = 0;
  double start_ = 0, dt_ = 0;
};

// The longest flight of a run so far, of those beyond a radius.
class FlightRecord {
 public:
  FlightRecord() = default;
  explicit FlightRecord(const WorldState& state)
      : fast_spheres_(state.fast_spheres), flight_(state.fastest_flight), dt_(state.fastest_dt) {}
  void save(WorldState& state) const {
    state.fast_spheres = fast_spheres_;
    state.fastest_flight = flight_;
    state.fastest_dt = dt_;
  }

  void add(const Watch& watch, double dt) {
    for (const Watch::Tally& tally : watch.tallies) {
      fast_spheres_ += static_cast<std::int64_t>(tally.spheres);
      const double flight = float_of(static_cast<std::uint32_t>(tally.longest_flight));
      if (flight * dt_ <= flight_ * dt) continue;  // no faster than the record
      flight_ = flight;
      dt_ = dt;
    }
  }
  // iterations: into which a frame is divided; dt: of the frame that safe_iterations is for [s]
  FastFlights report(int iterations, double dt) const {
    if (fast_spheres_ == 0) return {0, iterations, std::numeric_limits<double>::infinity()};
    return {fast_spheres_, static_cast<std::int64_t>(std::ceil(iterations * flight_ * (dt / dt_))), dt_ / flight_};
  }

 private:
  std::int64_t fast_spheres_ = 0;
  double flight_ = 0, dt_ = 1;  // in radii; of its frame [s]
};

class Engine {
 public:
  virtual ~Engine() = default;
  virtual void append(const Spheres& spheres) = 0;
  // Spheres and crowding; clock and flights know their own part of a state.
  virtual void save(WorldState& state) = 0;
  virtual void restore(const WorldState& state) = 0;
  virtual std::int64_t step(std::int64_t frames, double dt, const std::function<bool()>& go_on) = 0;
  // Of a running world: what it says of gravity, drag and walls, but neither box nor solver.
  virtual void change_options(const WorldOptions& options) = 0;
  // The same value for all spheres.
  virtual void fill(Field field, float value) = 0;
  virtual std::int64_t count() const = 0;
  virtual bool has_spin() const = 0;
  virtual ArrayView array(Field field) = 0;
  virtual ContactArrays contacts() = 0;
  virtual std::int64_t contact_count() = 0;
  virtual Ledger ledger() = 0;
  virtual float max_overlap() = 0;
  virtual double mean_overlap() = 0;
  virtual ContactSummary contact_summary() = 0;
  virtual std::uint64_t state_hash() = 0;

  std::string device_name;
  Clock clock;
  FlightRecord flights;
  StageTimer timer;
  // Threads that share a world take turns. Recursive, since a signal handler may ask the world that it interrupts.
  std::recursive_mutex mutex;
  bool is_stepping = false;
};

class RendererEngine {
 public:
  virtual ~RendererEngine() = default;
  virtual void draw(const Picture& picture, std::int64_t count, const float* positions, const float* radii,
                    const float* values, int cuda_device, std::uint8_t* rgb) = 0;
};

// One of each in step_cpu.cpp; those of CUDA in step_cuda.cu or, as errors, in no_cuda.cpp.
std::unique_ptr<Engine> make_cpu_engine(const WorldOptions& options, int threads);
std::unique_ptr<Engine> make_cuda_engine(const WorldOptions& options, int device);
std::unique_ptr<RendererEngine> make_cpu_renderer(int threads);
std::unique_ptr<RendererEngine> make_cuda_renderer(int device);
Spheres cpu_random_spheres(const RandomSpheres& random);
Spheres cuda_random_spheres(const RandomSpheres& random, int device);
std::vector<Device> cuda_devices();
void cuda_copy_to_host(void* host, const void* device, std::size_t bytes, int cuda_device);
int device_of_cuda_memory(const void* address);

inline Vec3 vector_of(const std::array<float, 3>& a) { return {a[0], a[1], a[2]}; }

template <Backend B>
class EngineOn final : public Engine {
 public:
  EngineOn(const WorldOptions& options, B backend) : options_(options), backend_(std::move(backend)) {}

  void append(const Spheres& spheres) override {
    const std::int64_t before = count(), added = static_cast<std::int64_t>(spheres.radius.size());
    if (!spheres.spin.empty() || !spheres.friction.empty()) make_rough();
    try {
      bodies_.resize(before + added);
    } catch (...) {
      bodies_.resize(before);  // some arrays had grown already
      throw;
    }
    const auto write = [&](auto& buffer, const std::vector<float>& from, int columns) {
      backend_.copy_to_device(reinterpret_cast<float*>(buffer.data() + before), from.data(), added * columns);
    };
    write(bodies_.positions, spheres.position, 3);
    write(bodies_.velocities, spheres.velocity, 3);
    write(bodies_.radii, spheres.radius, 1);
    write(bodies_.masses, spheres.mass, 1);
    write(bodies_.restitutions, spheres.restitution, 1);
    if (bodies_.is_rough) {
      backend_.fill_zero(bodies_.spins.data() + before, added);
      backend_.fill_zero(bodies_.frictions.data() + before, added);
      if (!spheres.spin.empty()) write(bodies_.spins, spheres.spin, 3);
      if (!spheres.friction.empty()) write(bodies_.frictions, spheres.friction, 1);
    }
    backend_.synchronize();
    is_crowding_known_ = false;
  }

  void save(WorldState& state) override {
    check();
    const auto read = [&](const auto& buffer, int columns) {
      std::vector<float> values(static_cast<std::size_t>(count() * columns));
      backend_.copy_to_host(values.data(), reinterpret_cast<const float*>(buffer.data()), count() * columns);
      return values;
    };
    const Bodies<B>& bodies = bodies_;
    state.spheres = {read(bodies.positions, 3),
                     read(bodies.velocities, 3),
                     read(bodies.radii, 1),
                     read(bodies.masses, 1),
                     read(bodies.restitutions, 1),
                     {},
                     {}};
    if (bodies.is_rough) {
      state.spheres.spin = read(bodies.spins, 3);
      state.spheres.friction = read(bodies.frictions, 1);
    }
    if (is_crowding_known_) state.crowding = read(std::as_const(scratch_.substep.crowding), 1);
    memory_.save(state.contacts);
  }

  void restore(const WorldState& state) override {
    append(state.spheres);
    if (!state.contacts.owner.empty()) memory_.restore(state.contacts, count(), words_of_memory());
    if (state.crowding.empty()) return;
    scratch_.substep.crowding.resize(count());
    backend_.copy_to_device(scratch_.substep.crowding.data(), state.crowding.data(), count());
    backend_.synchronize();
    is_crowding_known_ = true;
  }

  std::int64_t step(std::int64_t frames, double dt, const std::function<bool()>& go_on) override {
    shape_grid();
    FrameParameters parameters = frame_parameters(dt);
    if (options_.solver == Solver::substep && !is_crowding_known_) find_crowding(parameters.substep);
    bool may_have_changed = true;
    for (std::int64_t done = 0; done < frames;) {
      if (go_on && !go_on()) return done;
      const std::int64_t some = std::min(frames - done, frames_of_next_run());
      const auto start = std::chrono::steady_clock::now();
      const auto [watch, simulated] = run_frames(some, parameters, may_have_changed);
      if (watch.first_fault != no_fault) {
        // Back to the last good frame: the same frames give the same state again.
        const auto good = static_cast<std::int64_t>(fault_frame(watch.first_fault));
        for (std::int64_t again = 0; again < good;) {
          const RunResult part = run_frames(good - again, parameters, true);
          flights.add(part.watch, dt);
          again += part.frames;
        }
        clock.advance(good, dt);
        refuse_fault(watch.first_fault, clock.frame() + 1);
      }
      adapt_frames_at_once(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
      may_have_changed = false;
      flights.add(watch, dt);
      clock.advance(simulated, dt);
      done += simulated;
    }
    return frames;
  }

  void change_options(const WorldOptions& options) override { options_ = options; }

  void fill(Field field, float value) override {
    const ArrayView view = array(field);
    const std::vector<float> values(static_cast<std::size_t>(count()), value);
    backend_.copy_to_device(static_cast<float*>(view.data), values.data(), count());
    backend_.synchronize();
  }

  std::int64_t count() const override { return bodies_.count(); }

  bool has_spin() const override { return bodies_.is_rough; }

  ArrayView array(Field field) override {
    switch (field) {
      case Field::position:
        return view(bodies_.positions, 3);
      case Field::velocity:
        return view(bodies_.velocities, 3);
      case Field::radius:
        return view(bodies_.radii, 0);
      case Field::mass:
        return view(bodies_.masses, 0);
      case Field::restitution:
        return view(bodies_.restitutions, 0);
      case Field::spin:
        make_rough();
        return view(bodies_.spins, 3);
      case Field::friction:
        make_rough();
        return view(bodies_.frictions, 0);
    }
    return {};
  }

  ContactArrays contacts() override {
    Contacts<B> found(backend_);
    if (count() > 0) {
      update_grid();
      find_pairs(backend_, scratch_.grid, bodies_, found);
      backend_.synchronize();
    }
    return {view(found.first, 0), view(found.second, 0), view(found.gap, 0), view(found.normal, 3)};
  }

  std::int64_t contact_count() override {
    if (count() == 0) return 0;
    update_grid();
    Contacts<B> found(backend_);
    return count_pairs(backend_, scratch_.grid, found);
  }

  Ledger ledger() override {
    backend_.synchronize();
    return count() == 0 ? Ledger{} : measure_ledger(backend_, vector_of(options_.gravity), box(), bodies_);
  }

  float max_overlap() override {
    if (count() == 0) return 0;
    update_grid();
    return measure_max_overlap(backend_, box(), scratch_.grid);
  }

  double mean_overlap() override {
    if (count() == 0) return 0;
    update_grid();
    return measure_mean_overlap(backend_, scratch_.grid);
  }

  ContactSummary contact_summary() override {
    if (count() == 0) return {};
    update_grid();
    return measure_contacts(backend_, box(), scratch_.grid, contact_scratch_);
  }

  std::uint64_t state_hash() override {
    backend_.synchronize();
    return hash_state(backend_, bodies_);
  }

 private:
  template <class Buffer>
  ArrayView view(Buffer& buffer, int columns) {
    return {buffer.data(), buffer.size(), columns, backend_.cuda_device(), buffer.share()};
  }

  FrameParameters frame_parameters(double dt) const {
    const double flight_time = options_.solver == Solver::substep ? dt / options_.iterations : dt;
    const Vec3 gravity = vector_of(options_.gravity);
    const SolverScales scales = solver_scales(largest_radius_, static_cast<float>(dt));
    return {options_.solver,
            options_.iterations,
            scales,
            {soft_contact_law(static_cast<float>(flight_time), gravity, largest_radius_, options_.rolling_friction),
             flight_for(flight_time, gravity, options_.drag),
             gravity,
             box(),
             {options_.floor_restitution, options_.wall_friction},
             scales.velocity,
             0}};
  }

  // Few enough frames that a fault is told and a wish to stop is heard soon; enough that a GPU is not kept waiting, and
  // that to bring the bodies into the order of the cells and back is little beside them: of 100,000,000 it takes as
  // long as a frame.
  void adapt_frames_at_once(double seconds) {
    if (seconds < 0.1 && frames_at_once_ < 4096) frames_at_once_ *= 2;
    if (seconds > 1.0 && frames_at_once_ > 1) frames_at_once_ /= 2;
  }

  void find_crowding(const Substep& substep) {
    build_grid(backend_, bodies_, nullptr, scratch_.grid);
    measure_crowding(backend_, substep.law, box(), scratch_.grid, scratch_.substep);
    is_crowding_known_ = true;
  }

  void make_rough() {
    if (bodies_.is_rough) return;
    bodies_.spins.resize(count());
    bodies_.frictions.resize(count());
    backend_.fill_zero(bodies_.spins.data(), count());
    backend_.fill_zero(bodies_.frictions.data(), count());
    backend_.synchronize();
    bodies_.is_rough = true;
  }

  // How far apart two surfaces may be that a stage still looks at [m].
  float opening_margin() const {
    return options_.solver == Solver::substep ? soft_contact_law(1.0f, {}, largest_radius_, 0.0f).opening_margin : 0.0f;
  }

  Box box() const { return box_of(options_); }

  // The user may have written to any array since the last run.
  StateCheck check() {
    backend_.synchronize();
    const RadiusRange allowed = allowed_radii(box());
    const StateCheck found = check_state(backend_, box(), allowed.smallest, allowed.largest, bodies_);
    if (found.first_bad != no_fault) refuse(static_cast<std::int64_t>(found.first_bad / 8), Field(found.first_bad % 8));
    return found;
  }

  // Every run starts here.
  void shape_grid() {
    const StateCheck found = check();
    bring_in(backend_, box(), bodies_);
    largest_radius_ = float_of(static_cast<std::uint32_t>(found.largest_radius));
    has_friction_ = options_.solver == Solver::substep && bodies_.is_rough &&
                    (found.largest_friction > 0 || options_.wall_friction > 0.0f || options_.rolling_friction > 0.0f);
    scratch_.grid.period = period_of(box());
    if (count() != surveyed_count_ || found.radius_digest != surveyed_digest_) {
      surveyed_count_ = -1;  // nothing is known should something go wrong on the way
      survey_radii(float_of(static_cast<std::uint32_t>(found.smallest_radius)));
      levels_ = choose_levels(box(), radii_, count(), opening_margin());
      surveyed_count_ = count();
      surveyed_digest_ = found.radius_digest;
    }
    scratch_.grid.levels =
        are_sizes_far_apart() && options_.cell_size == 0.0f
            ? levels_
            : one_level(choose_grid_shape(box(), largest_radius_, options_.cell_size, count(), opening_margin()));
  }

  void survey_radii(float smallest) {
    radii_ = {largest_radius_, {count()}};
    if (smallest > 0.25f * largest_radius_) return;
    SmallerThanLimits is_smaller{std::as_const(bodies_.radii).data(), {}};
    const int exponent = std::ilogb(largest_radius_);
    for (int k = 0; k < octaves - 1; ++k) is_smaller.limits[k] = std::ldexp(1.0f, exponent - k);
    const SmallerCounts found =
        backend_.transform_reduce(count(), is_smaller, SmallerCounts{}, SmallerCounts::Operation{});
    for (int k = 0; k < octaves - 1; ++k) {
      radii_.octave_counts[k] -= found.counts[k];
      radii_.octave_counts[k + 1] = found.counts[k];
    }
  }

  // Whether cells or lists made for the largest sphere would hold far too many of the others.
  bool are_sizes_far_apart() const {
    return levels_.count > 1 && size_spread(radii_) > (B::has_whole_grid ? widest_spread_on_gpu : widest_spread_on_cpu);
  }

  void update_grid() {
    shape_grid();
    build_grid(backend_, bodies_, nullptr, scratch_.grid);
  }

  void refuse(std::int64_t id, Field field) {
    const ArrayView view = array(field);
    const int columns = std::max(1, view.columns);
    float found[3];
    backend_.copy_to_host(found, static_cast<const float*>(view.data) + id * columns, columns);
    refuse_value(box(), field, id, found);
  }

  // Runs frames, or the first of them, or, when something goes wrong in one of them, none.
  RunResult run_frames(std::int64_t frames, const FrameParameters& parameters, bool may_have_changed) {
    if (has_friction_ || memory_.is_kept()) memory_.resize(count(), words_of_memory());
    const std::int64_t planned_by_levels = frames_by_levels_;
    RunResult result = try_frames(frames, parameters, may_have_changed);
    while (!memory_.had_room(result.watch)) {
      frames_by_levels_ = std::max(frames_by_levels_, planned_by_levels);  // by levels again, if it was
      result = try_frames(frames, parameters, true);
    }
    if (result.watch.first_fault == no_fault) memory_.end_run(result.watch, result.frames * options_.iterations);
    return result;
  }

  std::uint32_t words_of_memory() const { return options_.rolling_friction > 0.0f ? 2 : 1; }

  RunResult try_frames(std::int64_t frames, FrameParameters parameters, bool may_have_changed) {
    are_lists_behind_ = are_lists_behind_ || may_have_changed;
    if (is_small(parameters)) {
      are_lists_behind_ = true;
      return {small_runs_.run(parameters, frames, largest_radius_, body_arrays(), count(), timer), frames};
    }
    if (sorts_by_levels()) return run_by_levels(frames, parameters);
    if (frames_by_levels_ > 0) {
      try {
        return run_by_levels(frames, parameters);
      } catch (const OutOfMemory&) {  // a wish: lists for each frame have their memory already
        level_runs_.emplace(backend_);
        may_use_levels_ = false;
        plan_levels();
      }
    }
    if (makes_lists_for_each_frame()) {
      const std::optional<RunResult> result =
          frame_runs_.run(parameters, frames, largest_radius_, body_arrays(), count(), memory_, timer);
      are_lists_behind_ = true;
      plan_levels();
      if (result) return *result;
    }
    if (mends_lists()) {
      const std::optional<Watch> watch =
          listed_.run(parameters, frames, are_lists_behind_, largest_radius_, body_arrays(), count(), memory_, timer);
      are_lists_behind_ = false;
      if (watch) return {*watch, frames};
    }
    if (options_.method == Method::automatic) return run_by_levels(frames, parameters);
    are_lists_behind_ = true;
    keep_state();
    Watch watch;
    backend_.copy_to_device(scratch_.watch.data(), &watch, 1);
    const MemoryCopies memory = memory_.start_run(scratch_.watch.data(), frames * options_.iterations);
    for (std::int64_t i = 0; i < frames; ++i) {
      parameters.substep.frame = static_cast<std::uint32_t>(i);
      simulate_frame(backend_, parameters, bodies_, memory, scratch_, timer);
    }
    backend_.copy_to_host(&watch, static_cast<const Watch*>(scratch_.watch.data()), 1);
    if (watch.first_fault != no_fault) restore_state();
    return {watch, frames};
  }

  bool is_small(const FrameParameters& parameters) {
    const bool is_asked_for = options_.method == Method::small;
    if (!is_asked_for && (options_.method != Method::automatic || !small_runs_.pays(count()))) return false;
    if (small_runs_.has_room(parameters, body_arrays(), count())) return true;
    if (!is_asked_for) return false;
    throw InvalidValue("method", -1,
                       "\"small\" for " + std::to_string(count()) + " spheres" +
                           (bodies_.is_rough && options_.solver == Solver::substep ? " with friction or spin" : ""),
                       "smooth spheres, as many as fit into the shared memory of a multiprocessor of compute "
                       "capability 9.0 or above, on a CPU at most 4,096");
  }

  bool sorts_by_levels() const {
    return options_.method == Method::levels || (options_.method == Method::automatic && are_sizes_far_apart());
  }

  bool makes_lists_for_each_frame() const {
    return options_.method == Method::frame || (options_.method == Method::automatic && B::has_whole_grid);
  }

  bool mends_lists() const {
    return options_.method != Method::cells && !(options_.method == Method::automatic && B::has_whole_grid);
  }

  RunResult run_by_levels(std::int64_t frames, const FrameParameters& parameters) {
    frames_by_levels_ -= frames;
    are_lists_behind_ = true;
    return {level_runs_->run(parameters, frames, levels_, radii_, body_arrays(), count(), memory_, timer), frames};
  }

  // Where lists for each frame do not save the search, to search in each pass is sooner done for a spell; then one
  // frame tells whether that is still so.
  void plan_levels() {
    looks_for_end_ = options_.method == Method::automatic && may_use_levels_ && frame_runs_.had_to_search();
    frames_by_levels_ = looks_for_end_ ? level_spell : 0;
  }
  std::int64_t frames_of_next_run() const {
    if (!looks_for_end_) return frames_at_once_;
    return frames_by_levels_ > 0 ? std::min(frames_by_levels_, frames_at_once_) : 1;
  }

  BodyArrays body_arrays() {
    const bool has_crowding = options_.solver == Solver::substep;
    return {bodies_.positions.data(),
            bodies_.velocities.data(),
            bodies_.radii.data(),
            bodies_.masses.data(),
            bodies_.restitutions.data(),
            has_crowding ? scratch_.substep.crowding.data() : nullptr,
            bodies_.is_rough ? bodies_.spins.data() : nullptr,
            bodies_.is_rough ? bodies_.frictions.data() : nullptr};
  }

  void keep_state() {
    kept_positions_.resize(count());
    kept_velocities_.resize(count());
    backend_.copy(kept_positions_.data(), std::as_const(bodies_.positions).data(), count());
    backend_.copy(kept_velocities_.data(), std::as_const(bodies_.velocities).data(), count());
    if (bodies_.is_rough) {
      kept_spins_.resize(count());
      backend_.copy(kept_spins_.data(), std::as_const(bodies_.spins).data(), count());
    }
    if (options_.solver == Solver::substep) {
      kept_crowding_.resize(count());
      backend_.copy(kept_crowding_.data(), std::as_const(scratch_.substep.crowding).data(), count());
    }
  }
  void restore_state() {
    backend_.copy(bodies_.positions.data(), std::as_const(kept_positions_).data(), count());
    backend_.copy(bodies_.velocities.data(), std::as_const(kept_velocities_).data(), count());
    if (bodies_.is_rough) backend_.copy(bodies_.spins.data(), std::as_const(kept_spins_).data(), count());
    if (options_.solver == Solver::substep) {
      backend_.copy(scratch_.substep.crowding.data(), std::as_const(kept_crowding_).data(), count());
    }
  }

  WorldOptions options_;
  B backend_;
  Bodies<B> bodies_{backend_};
  Scratch<B> scratch_{backend_};
  ContactScratch<B> contact_scratch_{backend_};
  FrameRuns<B> frame_runs_{backend_};
  std::optional<LevelRuns<B>> level_runs_{std::in_place, backend_};
  SmallRuns<B> small_runs_{backend_};
  ListedFrames<B> listed_{backend_};
  ContactMemory<B> memory_{backend_};
  // Before unchecked frames:
  typename B::template Buffer<Vec3> kept_positions_{backend_}, kept_velocities_{backend_}, kept_spins_{backend_};
  typename B::template Buffer<float> kept_crowding_{backend_};
  float largest_radius_ = 0;
  RadiusSurvey radii_{};
  std::int64_t surveyed_count_ = -1;  // of the spheres that it is of
  std::uint64_t surveyed_digest_ = 0;
  CellLevels levels_{};
  std::int64_t frames_at_once_ = B::frames_between_checks;
  static constexpr std::int64_t level_spell = 24;
  std::int64_t frames_by_levels_ = 0;  // of a spell, those still to come
  bool looks_for_end_ = false;         // of the spells
  bool may_use_levels_ = true;         // in place of lists: there was memory for both so far
  bool are_lists_behind_ = false;      // bodies may have been changed by others since lists were run
  bool is_crowding_known_ = false;
  bool has_friction_ = false;  // of the default solver, where spheres turn: contacts remember
};

}  // namespace fastcollide
