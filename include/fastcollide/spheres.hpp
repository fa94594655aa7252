// Spheres as plain arrays on the host.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace fastcollide {

struct Spheres {
  std::vector<float> position;     // x, y, z of each sphere [m], 3 * count values
  std::vector<float> velocity;     // [m/s], 3 * count values
  std::vector<float> radius;       // [m]
  std::vector<float> mass;         // [kg]; infinite: fixed, see World::add
  std::vector<float> restitution;  // 0 ... 1
  // May be empty: all at rest, without friction. A world that never gets any of the two keeps no memory for them.
  std::vector<float> spin;      // [rad/s], 3 * count values
  std::vector<float> friction;  // Coulomb coefficient
};

// A random start: positions uniform among those where the whole sphere lies in the box, the others uniform between
// their limits.
struct RandomSpheres {
  std::int64_t count = 10000;
  std::uint64_t seed = 1;
  std::array<float, 3> lower{-10, -10, 0}, upper{10, 10, 20};  // the box [m]
  std::array<float, 2> radius{0.05f, 0.4f};                    // [m]
  std::array<float, 3> speed{8, 8, 8};  // v_x and v_y lie in ± the first two, v_z in 0 ... the third [m/s]
  std::array<float, 2> restitution{0.3f, 0.95f};
  float density = 1000;  // [kg/m³]
};

// A function of its arguments alone: the same bits on every device. `device` is "cpu", "cuda" or "cuda:N".
// Errors: InvalidValue for an argument out of range, DeviceError without such a device, OutOfMemory.
Spheres random_spheres(const RandomSpheres& random, const std::string& device = "cpu");

}  // namespace fastcollide
