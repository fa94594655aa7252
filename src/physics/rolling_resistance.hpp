// Rolling resistance: a moment against the relative spin of two surfaces in contact.
//
// The directional constant torque (type A) of Ai, Chen, Rotter and Ooi, "Assessment of rolling resistance models in
// discrete element simulations", Powder Technology 206 (2011): the moment is at most rolling_friction * R * F, with F
// the normal force and R = r_1 r_2 / (r_1 + r_2), the radius at a wall. As an impulse of one substep it takes no more
// than all of the relative spin.
#pragma once

#include "contact.hpp"

namespace fastcollide {

// What is taken from a relative spin: up to `most`, and at most `part` of it.
FC_HOST_DEVICE inline Vec3 brake(Vec3 spin, float most, float part) {
  const float speed = length(spin);
  if (!(speed > 0.0f && most > 0.0f)) return {0, 0, 0};
  return spin * (-(smaller(most, part * speed) / speed));
}

// How a moment on a pair is shared. I = 2/5 m r² for each; the moments of the two are opposite.
struct RollingPair {
  float own_radius, own_share;
  float lever;  // change of the relative spin by a unit of normal change, per rolling_friction [rad/m]

  FC_HOST_DEVICE RollingPair(const Sphere& a, const Sphere& b) : own_radius(a.radius) {
    const float own = mass_share(a.mass, b.mass) * (b.radius / a.radius);
    const float both = own + mass_share(b.mass, a.mass) * (a.radius / b.radius);
    own_share = own / both;
    lever = 2.5f * both / (a.radius + b.radius);
  }
  // Of sphere a: its spin times its radius, from a change of the relative spin.
  FC_HOST_DEVICE Vec3 turn(Vec3 change) const { return change * (own_share * own_radius); }
};

// Change of sphere a's spin times its radius. normal_change: of the relative velocity along the normal, by the contact,
// so that the impulse is that times the reduced mass.
FC_HOST_DEVICE inline Vec3 resist_rolling_of_pair(const Sphere& a, const Sphere& b, Vec3 spin_a, Vec3 spin_b,
                                                  float normal_change, float rolling_friction, float part) {
  const RollingPair pair(a, b);
  return pair.turn(brake(spin_a - spin_b, rolling_friction * normal_change * pair.lever, part));
}

FC_HOST_DEVICE inline Vec3 resist_rolling_at_wall(float radius, Vec3 spin, float normal_change, float rolling_friction,
                                                  float part) {
  return brake(spin * radius, rolling_friction * normal_change * 2.5f, part);
}

}  // namespace fastcollide
