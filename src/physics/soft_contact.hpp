// The contact law of the default solver. A contact is one of three things in a substep:
//   impact   two spheres meet faster than a threshold and are not both held by others: the exact impulse of the pair,
//            with its restitution, for one pair of each sphere at a time;
//   resting  a spring and a damper along the normal, as stiff as a substep allows, cut by the crowding of the two;
//   waiting  an impact that is not the fastest of both its spheres acts in a later substep.
// docs/physics.md has the measurements behind each number.
#pragma once

#include "contact.hpp"
#include "crowding.hpp"
#include "wall.hpp"

namespace fastcollide {

struct SoftContactLaw {
  float substep;           // h [s]
  float gravity;           // |g| [m/s²]; without gravity there are no resting contacts
  float impact_speed;      // 3 |g| h: faster approach is an impact; slower is what gravity does in a few substeps [m/s]
  float full_load_depth;   // 4 |g| h²: a contact this deep counts fully in the crowding [m]
  float opening_margin;    // surfaces farther apart than this are not looked at [m]
  float rolling_friction;  // coefficient of the rolling resistance
};

// Of the smaller radius: an overlap that is left alone, so that rounding makes no impulse.
inline constexpr float slop_in_radii = 1e-4f;
// Of the smaller radius: an overlap pushes as if it were no deeper. With 0.15 a column of 28 still moved at 0.065 m/s
// after 20 s, with 0.2 and 0.3 at 0.030. Piles of 800 after 15 s: 0.008 to 0.024 m/s with 0.2 (five starts), 0.008 to
// 0.058 with 0.3 (six).
inline constexpr float deepest_push_in_radii = 0.2f;
// Spring: overlap times this per substep becomes separation speed. Damper 1 and spring 1.25 keep linear stability.
inline constexpr float spring = 1.25f;
// (1 + sqrt 2) / 2, the largest mass_weight, and a little for rounding.
inline constexpr float most_crowding_of_one_contact = 1.2072f;
// Push-out speed is capped [m/s]: for two spheres alone, so that an overlap at the start does not explode, and for a
// pile, where the push carries the load of everything above.
inline constexpr float fastest_lone_push = 1.0f, fastest_push = 8.0f;

inline SoftContactLaw soft_contact_law(float substep, Vec3 gravity, float largest_radius, float rolling_friction) {
  const float strength = length(gravity);
  return {substep,
          strength,
          3.0f * strength * substep,
          4.0f * strength * substep * substep,
          largest_radius * (1.0f / 32.0f),
          rolling_friction};
}

// Contacts come and go as a pile trembles: one that carries nothing still counts three quarters, so that the crowding,
// and with it every impulse, does not jump.
FC_HOST_DEVICE inline float load_weight(float depth, const SoftContactLaw& law) {
  return 0.75f + 0.25f * clamp(depth / law.full_load_depth, 0.0f, 1.0f);
}

// Two surfaces that come together within the next substep are counted before they touch: dozens of contacts may close
// in one substep, and each would push as if it were alone. A sphere of 0.8 m on a floor of fixed ones of 0.025 m, half
// a radius apart, was thrown up at 240 m/s.
FC_HOST_DEVICE inline bool will_close(float depth, float normal_velocity, const SoftContactLaw& law) {
  return depth - normal_velocity * law.substep > 0.0f;
}

// A heavy neighbour crowds a light sphere more than the other way round; a fixed one crowds it as a wall does.
FC_HOST_DEVICE inline float mass_weight(float own_mass, float other_mass) {
  if (is_fixed(other_mass)) return 1.0f;
  const float product = own_mass * other_mass;
  const bool is_in_range = product > 1e-30f && product < 1e38f;  // of float32, with all its places
  const float mean = is_in_range ? square_root(product) : square_root(own_mass) * square_root(other_mass);
  return (other_mass + mean) / (own_mass + other_mass);
}

// Gravity that only one of a pair feels [m/s²]: of a fixed sphere's partner. Free spheres fall together.
FC_HOST_DEVICE inline Vec3 relative_gravity(Vec3 gravity, float other_mass) {
  return is_fixed(other_mass) ? gravity : Vec3{0, 0, 0};
}

// Speed along the normal at which the spring of a resting contact pushes, before it is shared and cut by the crowding
// [m/s]. The damper takes the normal velocity from it.
FC_HOST_DEVICE inline float resting_push(float depth, float smaller_radius, float crowding, const SoftContactLaw& law) {
  const float fastest = crowding <= most_crowding_of_one_contact ? fastest_lone_push : fastest_push;
  return smaller(smaller(depth, deepest_push_in_radii * smaller_radius) * (spring / law.substep), fastest);
}

// Whether a sphere bounces off a wall, now or as soon as it touches, or is caught by it as by a resting contact. One
// that no resting contact holds bounces as long as it then flies for two substeps: it leaves at |g| h or more.
// `depth` and `normal_velocity`: before the gravity of this substep.
FC_HOST_DEVICE inline bool bounces_off_wall(float depth, float normal_velocity, float pull, float restitution,
                                            float crowding, const SoftContactLaw& law) {
  if (is_held(crowding) || normal_velocity >= 0.0f) return false;
  if (normal_velocity < -law.impact_speed) return true;
  return restitution * touching_speed(depth, normal_velocity, pull) >= law.gravity * law.substep;
}

}  // namespace fastcollide
