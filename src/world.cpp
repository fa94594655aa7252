// Validation, choice of the device, ownership.
#include "fastcollide/world.hpp"

#include <algorithm>
#include <cmath>

#include "device_choice.hpp"
#include "engine.hpp"
#include "float_environment.hpp"
#include "text.hpp"

namespace fastcollide {
namespace {

void require(bool good, const char* field, double found, const char* allowed, std::int64_t index = -1) {
  if (!good) throw InvalidValue(field, index, text_of(found), allowed);
}

// False for NaN.
bool between(double x, double low, double high) { return x >= low && x <= high; }

void check_box(const std::array<float, 3>& lower, const std::array<float, 3>& upper) {
  for (int axis = 0; axis < 3; ++axis) {
    const auto require_corner = [axis](bool good, const char* corner, float found, const std::string& allowed) {
      if (!good) throw InvalidValue("bounds", axis, std::string(corner) + " corner " + text_of(found), allowed);
    };
    require_corner(std::isfinite(lower[axis]), "lower", lower[axis], "finite numbers [m]");
    require_corner(std::isfinite(upper[axis]), "upper", upper[axis], "finite numbers [m]");
    require_corner(upper[axis] > lower[axis], "upper", upper[axis],
                   "more than the lower corner, " + text_of(lower[axis]) + " m");
    require_corner(upper[axis] - lower[axis] <= 1e18f, "upper", upper[axis], "sides of at most 1e18 m");
  }
}

void check_options(const WorldOptions& options) {
  check_box(options.lower, options.upper);
  for (int axis = 0; axis < 3; ++axis) {
    require(std::isfinite(options.gravity[axis]), "gravity", options.gravity[axis], "finite numbers [m/s²]", axis);
  }
  require(between(options.drag, 0, 1e6), "drag", options.drag, "0 to 1e6 [1/s]");
  require(between(options.floor_restitution, 0, 1), "floor_restitution", options.floor_restitution, "0 to 1");
  require(between(options.wall_friction, 0, 1e6), "wall_friction", options.wall_friction, "0 to 1e6");
  require(options.iterations >= 1 && options.iterations <= 1000, "iterations", options.iterations, "1 to 1000");
  require(between(options.cell_size, 0, 1e30), "cell_size", options.cell_size, "a finite number above 0 [m]");
  require(options.block_size >= 32 && options.block_size <= 512 && options.block_size % 32 == 0, "block_size",
          options.block_size, "a multiple of 32 from 32 to 512");
}

void check_lengths(const Spheres& spheres) {
  const std::size_t count = spheres.radius.size();
  const auto check = [count](const char* field, std::size_t found, std::size_t columns) {
    if (found == count * columns) return;
    throw InvalidValue(field, -1, std::to_string(found) + " numbers",
                       std::to_string(count * columns) + ", for " + std::to_string(count) + " radii");
  };
  check("position", spheres.position.size(), 3);
  check("velocity", spheres.velocity.size(), 3);
  check("mass", spheres.mass.size(), 1);
  check("restitution", spheres.restitution.size(), 1);
}

const float* value_of(const Spheres& spheres, Field field, std::int64_t i) {
  switch (field) {
    case Field::position:
      return spheres.position.data() + 3 * i;
    case Field::velocity:
      return spheres.velocity.data() + 3 * i;
    case Field::radius:
      return spheres.radius.data() + i;
    case Field::mass:
      return spheres.mass.data() + i;
    case Field::restitution:
      break;
  }
  return spheres.restitution.data() + i;
}

void check_spheres(const Spheres& spheres, const WorldOptions& options) {
  check_lengths(spheres);
  const RadiusRange radii = allowed_radii(options);
  const CheckBody body{radii.smallest,
                       radii.largest,
                       reinterpret_cast<const Vec3*>(spheres.position.data()),
                       reinterpret_cast<const Vec3*>(spheres.velocity.data()),
                       spheres.radius.data(),
                       spheres.mass.data(),
                       spheres.restitution.data()};
  for (std::int64_t i = 0; i < static_cast<std::int64_t>(spheres.radius.size()); ++i) {
    const StateCheck check = body(i);
    const Field field = Field(check.first_bad % 8);
    if (check.first_bad != no_fault) refuse_value(options, field, i, value_of(spheres, field, i));
    for (int axis = 0; axis < 3; ++axis) {
      const float x = spheres.position[static_cast<std::size_t>(3 * i + axis)];
      if (!between(x, options.lower[axis], options.upper[axis])) {
        throw InvalidValue(
            "position", i, std::string(1, "xyz"[axis]) + " = " + text_of(x),
            text_of(options.lower[axis]) + " to " + text_of(options.upper[axis]) + " m, inside the bounds");
      }
    }
  }
}

void check_random(const RandomSpheres& random) {
  check_box(random.lower, random.upper);
  require(random.count >= 0 && random.count <= most_spheres, "count", static_cast<double>(random.count),
          "0 to 268435456");
  require(random.radius[0] > 0 && std::isfinite(random.radius[0]), "radius", random.radius[0],
          "a finite number above 0 [m]", 0);
  require(random.radius[1] >= random.radius[0] && std::isfinite(random.radius[1]), "radius", random.radius[1],
          "a finite number not below the smallest radius [m]", 1);
  for (int axis = 0; axis < 3; ++axis) {
    require(2 * random.radius[1] <= random.upper[axis] - random.lower[axis], "radius", random.radius[1],
            "at most half of the shortest side of the bounds", 1);
    require(std::isfinite(random.speed[axis]) && random.speed[axis] >= 0, "speed", random.speed[axis],
            "a finite number not below 0 [m/s]", axis);
  }
  require(between(random.restitution[0], 0, 1), "restitution", random.restitution[0], "0 to 1", 0);
  require(between(random.restitution[1], random.restitution[0], 1), "restitution", random.restitution[1],
          "the lower limit to 1", 1);
  require(random.density > 0 && std::isfinite(random.density), "density", random.density,
          "a finite number above 0 [kg/m³]");
}

// What a call needs of the world: its turn, and the arithmetic of the standard.
class Turn {
 public:
  explicit Turn(Engine& engine) : lock_(engine.mutex) {}

 private:
  std::lock_guard<std::recursive_mutex> lock_;
  DefaultFloatEnvironment environment_;
};

// A call from within step(), out of a signal handler say, may read the world but not change it.
void require_rest(const Engine& engine) {
  if (engine.is_stepping) throw SimulationError("the world is in the middle of step(): it can be read, not changed");
}

std::unique_ptr<Engine> make_engine(const WorldOptions& options) {
  const DefaultFloatEnvironment environment;
  check_options(options);
  const int threads = choose_threads(options.threads), device = choose_device(options.device);
  std::unique_ptr<Engine> engine =
      device == cpu_device ? make_cpu_engine(options, threads) : make_cuda_engine(options, device);
  engine->device_name = device == cpu_device ? "cpu" : "cuda:" + std::to_string(device);
  return engine;
}

}  // namespace

World::World(const WorldOptions& options) : options_(options), engine_(make_engine(options)) {}
World::~World() = default;
World::World(World&&) noexcept = default;
World& World::operator=(World&&) noexcept = default;

std::int64_t World::add(const Spheres& spheres) {
  const Turn turn(*engine_);
  require_rest(*engine_);
  check_spheres(spheres, options_);
  const std::int64_t first = count();
  const std::int64_t total = first + static_cast<std::int64_t>(spheres.radius.size());
  if (total > most_spheres) {
    throw InvalidValue("count", -1, std::to_string(total) + " spheres in one world", "at most 268435456");
  }
  engine_->append(spheres);
  return first;
}

std::int64_t World::step(std::int64_t frames, double dt, const std::function<bool()>& go_on) {
  const Turn turn(*engine_);
  require_rest(*engine_);
  require(frames >= 0, "frames", static_cast<double>(frames), "0 or more");
  require(between(dt, 1e-9, 1e3), "dt", dt, "1e-9 to 1000 [s]");
  if (count() == 0) {
    engine_->clock.advance(frames, dt);
    return frames;
  }
  struct Stepping {
    explicit Stepping(bool& flag) : flag_(flag) { flag_ = true; }
    ~Stepping() { flag_ = false; }
    bool& flag_;
  } stepping(engine_->is_stepping);
  return engine_->step(frames, dt, go_on);
}

std::int64_t World::count() const {
  const Turn turn(*engine_);
  return engine_->count();
}

std::int64_t World::frame() const {
  const Turn turn(*engine_);
  return engine_->clock.frame();
}

double World::time() const {
  const Turn turn(*engine_);
  return engine_->clock.time();
}

const std::string& World::device() const { return engine_->device_name; }
const WorldOptions& World::options() const { return options_; }

std::string World::device_description() const {
  if (device() == "cpu") return cpu_description(choose_threads(options_.threads));
  for (const Device& found : devices()) {
    if (found.name == device()) return found.description;
  }
  return device();
}

ArrayView World::array(Field field) {
  const Turn turn(*engine_);
  return engine_->array(field);
}

ArrayView World::positions() { return array(Field::position); }
ArrayView World::velocities() { return array(Field::velocity); }
ArrayView World::radii() { return array(Field::radius); }
ArrayView World::masses() { return array(Field::mass); }
ArrayView World::restitutions() { return array(Field::restitution); }

ContactArrays World::contacts() {
  const Turn turn(*engine_);
  return engine_->contacts();
}

std::int64_t World::contact_count() {
  const Turn turn(*engine_);
  return engine_->contact_count();
}

Energy World::energy() {
  const Turn turn(*engine_);
  const Ledger ledger = engine_->ledger();
  return {ledger.kinetic, ledger.potential};
}

std::array<double, 3> World::momentum() {
  const Turn turn(*engine_);
  const Ledger ledger = engine_->ledger();
  return {ledger.momentum[0], ledger.momentum[1], ledger.momentum[2]};
}

float World::max_overlap() {
  const Turn turn(*engine_);
  return engine_->max_overlap();
}

std::uint64_t World::state_hash() {
  const Turn turn(*engine_);
  return engine_->state_hash();
}

void World::set_timed(bool timed) {
  const Turn turn(*engine_);
  engine_->timer.enabled = timed;
}

std::map<std::string, double> World::stage_times() const {
  const Turn turn(*engine_);
  return engine_->timer.seconds;
}

Spheres random_spheres(const RandomSpheres& random, const std::string& device) {
  const DefaultFloatEnvironment environment;
  check_random(random);
  const int number = choose_device(device);
  return number == cpu_device ? cpu_random_spheres(random) : cuda_random_spheres(random, number);
}

}  // namespace fastcollide
