// A box of colliding spheres.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "fastcollide/array_view.hpp"
#include "fastcollide/boundary.hpp"
#include "fastcollide/errors.hpp"
#include "fastcollide/spheres.hpp"
#include "fastcollide/world_state.hpp"

namespace fastcollide {

class Engine;
enum class Field : std::uint8_t;

// substep: stable at rest and in dense flow; reference: the report's summed loop, kept as a yardstick.
enum class Solver { substep, reference };

// How neighbours are found; no result depends on it. cells: a grid for every pass; list: lists that are mended and hold
// for many; frame: lists made anew for a frame or a few; levels: a grid for each size of spheres, for every pass;
// small: lists over all pairs, for few spheres. automatic takes levels where sizes differ much.
enum class Method { automatic, cells, list, frame, levels, small };

struct WorldOptions {
  std::array<float, 3> lower{-10, -10, 0}, upper{10, 10, 20};  // the box [m]
  std::array<Boundary, 3> boundary{};                          // of each axis; an open one needs no bounds
  std::array<float, 3> gravity{0, 0, -9.8f};                   // [m/s²]
  double drag = 0.06;                                          // v <- v exp(-drag dt) [1/s]
  float floor_restitution = 0.6f;  // of the lower z wall, 0 ... 1; the other walls use the sphere's own
  float wall_friction = 0.0f;      // Coulomb coefficient of all walls
  // Rolling resistance, where spheres turn: a moment of at most this times R times the normal force of a contact, with
  // R = r1 r2 / (r1 + r2), the radius at a wall.
  float rolling_friction = 0.0f;
  Solver solver = Solver::substep;
  int iterations = 5;           // substeps, or contact passes, a frame
  float cell_size = 0;          // edge of a grid cell [m]; 0: the smallest that misses no contact
  std::string device = "auto";  // "auto", "cpu", "cuda", "cuda:N"
  int threads = 0;              // of the CPU; 0: all
  Method method = Method::automatic;
  int block_size = 128;  // of CUDA, a multiple of 32 up to 512; no result depends on it
};

struct ContactArrays {
  ArrayView first, second;  // ids, int32, first < second, sorted by (first, second)
  ArrayView gap;            // distance of the surfaces, negative in overlap, float32 [m]
  ArrayView normal;         // from first to second, unit length, float32
};

struct Energy {
  // [J]; kinetic: of the translation; potential: 0 at the lower corner of the box, along an open axis at 0
  double kinetic = 0, rotational = 0, potential = 0;
};

// What World says of the whole state, each as the function of its name does.
struct Measurements {
  Energy energy;
  std::array<double, 3> momentum{}, angular_momentum{};
  std::int64_t contact_count = 0;
  float max_overlap = 0;
  double mean_overlap = 0;
};

// A sphere that moves farther than its radius in one substep (one frame of the reference solver) may pass through
// another one unseen.
struct FastFlights {
  std::int64_t fast_spheres = 0;     // times that one did since the world began
  std::int64_t safe_iterations = 0;  // substeps in a frame like the last for none to; no help to the reference solver
  double safe_dt = 0;                // frame for none to, with the iterations there are; infinite where none did [s]
};

// Threads that share a world take turns: each call waits for the one before.
class World {
 public:
  // Errors: InvalidValue, DeviceError.
  explicit World(const WorldOptions& options);
  ~World();
  World(World&&) noexcept;
  World& operator=(World&&) noexcept;

  // Returns the id of the first new sphere; ids count up from 0. All or nothing: InvalidValue names field and index.
  // A sphere of infinite mass is fixed: nothing changes its velocity and spin, and it moves with them, through walls
  // too. The others collide with it as with a wall; fixed spheres pass through each other.
  std::int64_t add(const Spheres& spheres);

  // Runs frames of dt seconds. go_on is asked between frames and ends the run by returning false. Returns the number of
  // frames done. Errors: InvalidValue when a number of the state was made invalid from outside, SimulationError when
  // the simulation leaves its range (the world then stands at the last good frame), DeviceError.
  std::int64_t step(std::int64_t frames, double dt, const std::function<bool()>& go_on = {});

  // A world that goes on from a saved state goes on as this one does, on any device and with any number of threads.
  // Errors of save: InvalidValue when a number of the state was made invalid from outside; of restore, which is for a
  // fresh world: InvalidValue names field and index, and the world stays fresh.
  WorldState save();
  void restore(const WorldState& state);

  // What a world may change between two frames; checked as at its start. Errors: InvalidValue, and nothing is changed.
  void set_gravity(const std::array<float, 3>& gravity);
  void set_drag(double drag);
  void set_floor_restitution(float floor_restitution);
  void set_wall_friction(float wall_friction);
  // The same for all spheres there are.
  void set_restitution(float restitution);
  void set_friction(float friction);

  std::int64_t count() const;
  std::int64_t frame() const;  // frames done
  double time() const;         // [s]
  const std::string& device() const;
  std::string device_description() const;
  const WorldOptions& options() const;

  // Whether there is memory for spins and frictions: once some sphere has them, or they were asked for.
  bool has_spin() const;

  // In the order of the ids; after add() a view may be an old copy.
  ArrayView positions();     // (count, 3) float32 [m]
  ArrayView velocities();    // (count, 3) float32 [m/s]
  ArrayView radii();         // (count,) float32 [m]
  ArrayView masses();        // (count,) float32 [kg]
  ArrayView restitutions();  // (count,) float32
  ArrayView spins();         // (count, 3) float32 [rad/s]; the first call makes room for them
  ArrayView frictions();     // (count,) float32; likewise

  ContactArrays contacts();
  std::int64_t contact_count();
  // Fixed spheres count in none of these: nothing takes energy or momentum from them.
  Energy energy();
  std::array<double, 3> momentum();          // [kg m/s]
  std::array<double, 3> angular_momentum();  // about the origin [kg m²/s]
  // Of two spheres that are not both fixed: the deepest, or that of a sphere in a wall if deeper [m]; and the mean of
  // the pairs, each as a part of its smaller radius, 0 without any.
  float max_overlap();
  double mean_overlap();
  // All of these at once, in a fraction of the time: pairs are looked for once.
  Measurements measure();
  std::uint64_t state_hash();
  FastFlights fast_flights() const;

  // Seconds spent in each stage while timed; timing makes a GPU wait after each stage.
  void set_timed(bool timed);
  std::map<std::string, double> stage_times() const;

 private:
  ArrayView array(Field field);
  template <class Change>
  void change(Change change_options);

  WorldOptions options_;
  std::unique_ptr<Engine> engine_;
};

}  // namespace fastcollide
