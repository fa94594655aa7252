// Choice of the device, turns, ownership.
#include "fastcollide/world.hpp"

#include "device_choice.hpp"
#include "engine.hpp"
#include "float_environment.hpp"
#include "validation.hpp"

namespace fastcollide {
namespace {

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

Energy energy_of(const Ledger& ledger) { return {ledger.kinetic, ledger.rotational, ledger.potential}; }

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
  check_count(first + static_cast<std::int64_t>(spheres.radius.size()));
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

WorldState World::save() {
  const Turn turn(*engine_);
  require_rest(*engine_);
  WorldState state;
  engine_->save(state);
  engine_->clock.save(state);
  engine_->flights.save(state);
  return state;
}

void World::restore(const WorldState& state) {
  const Turn turn(*engine_);
  require_rest(*engine_);
  require(engine_->count() == 0 && engine_->clock.frame() == 0, "state", static_cast<double>(engine_->clock.frame()),
          "a world without spheres, at frame 0");
  check_world_state(state, options_);
  engine_->restore(state);
  engine_->clock = Clock(state);
  engine_->flights = FlightRecord(state);
}

template <class Change>
void World::change(Change change_options) {
  const Turn turn(*engine_);
  require_rest(*engine_);
  WorldOptions changed = options_;
  change_options(changed);
  check_options(changed);
  engine_->change_options(changed);
  options_ = changed;
}

void World::set_gravity(const std::array<float, 3>& gravity) {
  change([&](WorldOptions& options) { options.gravity = gravity; });
}
void World::set_drag(double drag) {
  change([&](WorldOptions& options) { options.drag = drag; });
}
void World::set_floor_restitution(float floor_restitution) {
  change([&](WorldOptions& options) { options.floor_restitution = floor_restitution; });
}
void World::set_wall_friction(float wall_friction) {
  change([&](WorldOptions& options) { options.wall_friction = wall_friction; });
}

void World::set_restitution(float restitution) {
  const Turn turn(*engine_);
  require_rest(*engine_);
  check_restitution(restitution);
  engine_->fill(Field::restitution, restitution);
}

void World::set_friction(float friction) {
  const Turn turn(*engine_);
  require_rest(*engine_);
  check_friction(friction, options_);
  engine_->fill(Field::friction, friction);
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

bool World::has_spin() const {
  const Turn turn(*engine_);
  return engine_->has_spin();
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
ArrayView World::spins() { return array(Field::spin); }
ArrayView World::frictions() { return array(Field::friction); }

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
  return energy_of(engine_->ledger());
}

std::array<double, 3> World::momentum() {
  const Turn turn(*engine_);
  return std::to_array(engine_->ledger().momentum);
}

std::array<double, 3> World::angular_momentum() {
  const Turn turn(*engine_);
  return std::to_array(engine_->ledger().angular_momentum);
}

float World::max_overlap() {
  const Turn turn(*engine_);
  return engine_->max_overlap();
}

double World::mean_overlap() {
  const Turn turn(*engine_);
  return engine_->mean_overlap();
}

Measurements World::measure() {
  const Turn turn(*engine_);
  const Ledger ledger = engine_->ledger();
  const ContactSummary contacts = engine_->contact_summary();
  return {energy_of(ledger), std::to_array(ledger.momentum), std::to_array(ledger.angular_momentum),
          contacts.contacts, contacts.max_overlap,           contacts.mean_overlap};
}

std::uint64_t World::state_hash() {
  const Turn turn(*engine_);
  return engine_->state_hash();
}

FastFlights World::fast_flights() const {
  const Turn turn(*engine_);
  return engine_->flights.report(options_.iterations, engine_->clock.dt());
}

void World::set_timed(bool timed) {
  const Turn turn(*engine_);
  engine_->timer.enabled = timed;
}

std::map<std::string, double> World::stage_times() const {
  const Turn turn(*engine_);
  return engine_->timer.seconds();
}

Spheres random_spheres(const RandomSpheres& random, const std::string& device) {
  const DefaultFloatEnvironment environment;
  check_random(random);
  const int number = choose_device(device);
  return number == cpu_device ? cpu_random_spheres(random) : cuda_random_spheres(random, number);
}

}  // namespace fastcollide
