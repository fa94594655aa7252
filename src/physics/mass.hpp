// How a pair shares what happens between the two. A sphere of infinite mass is fixed: no force, gravity or contact
// changes its velocity or spin, and its partner meets a wall.
#pragma once

#include "../math.hpp"

namespace fastcollide {

// The sum of two masses must be a finite float32 [kg].
inline constexpr float largest_mass = 1e38f;

FC_HOST_DEVICE inline bool is_fixed(float mass) { return mass > largest_mass; }

// Part of a relative change that falls to the sphere of mass `own`, not to its partner: the lighter one moves more. A
// fixed `own` gets 0; two fixed spheres never ask.
FC_HOST_DEVICE inline float mass_share(float own, float other) {
  return is_fixed(other) ? 1.0f : other / (own + other);
}

}  // namespace fastcollide
