// All that a world carries from one step to the next, as plain numbers on the host.
#pragma once

#include <cstdint>
#include <vector>

#include "fastcollide/spheres.hpp"

namespace fastcollide {

// How far the surfaces of rough contacts have slipped and rolled, held by friction: docs/physics.md. One entry for each
// pair that remembers any, sorted by owner and partner.
struct ContactState {
  std::vector<std::uint32_t> owner;    // id
  std::vector<std::uint32_t> partner;  // id, or first_wall + 0 ... 5 for the lower and upper wall of x, y, z
  std::vector<float> slide;            // of the owner's surface over the partner's, three for each entry [m]
  std::vector<float> roll;             // its turn against the partner, likewise [rad]; empty without rolling friction

  static constexpr std::uint32_t first_wall = 0xFFFFFFF0u;
};

// With the options of its world it says all frames to come, to the last bit, on every device.
struct WorldState {
  Spheres spheres;  // in the order of the ids; spin and friction are empty where the world keeps none
  // What the default solver remembers of each sphere from substep to substep, see docs/physics.md; empty where it knows
  // nothing, as before the first step.
  std::vector<float> crowding;
  ContactState contacts;
  std::int64_t frame = 0;  // frames done
  // Frames of the present length began at this frame and time [s]; the time now is start_time + (frame - start_frame)
  // dt.
  std::int64_t start_frame = 0;
  double start_time = 0, dt = 0;
  // See FastFlights: how many, and the fastest one, in radii in a frame of fastest_dt [s].
  std::int64_t fast_spheres = 0;
  double fastest_flight = 0, fastest_dt = 1;
};

}  // namespace fastcollide
