// Coulomb friction at a contact point, for spheres that turn and for such that only slide.
#pragma once

#include "../math.hpp"

namespace fastcollide {

// The point of contact, as seen from a sphere: at -normal * arm from its centre. The arms of a pair add up to the
// distance of the centres, so that the two opposite impulses have no moment about any point: angular momentum is kept.
struct Slip {
  Vec3 velocity;     // of the first surface over the second, along the contact plane [m/s]
  float resistance;  // slip that a unit of tangential velocity change takes away: 1 without rotation
};

// Relative velocity of the centres, spins times arms of both, added.
FC_HOST_DEVICE inline Slip slip_at(Vec3 relative_velocity, Vec3 normal, Vec3 turning, float resistance) {
  const Vec3 surface = relative_velocity - cross(turning, normal);
  return {surface - normal * dot(surface, normal), resistance};
}

// Change of the relative tangential velocity of the centres: against the slip, at most friction times the normal
// change, and no more than stops the slip (times `part` <= 1, for a contact that shares its spheres with others).
FC_HOST_DEVICE inline Vec3 friction_change(const Slip& slip, float normal_change, float friction, float part) {
  const float speed = length(slip.velocity);
  const float most = friction * normal_change;
  if (!(speed > 0.0f && most > 0.0f)) return {0.0f, 0.0f, 0.0f};
  const float change = smaller(most, part * speed / slip.resistance);
  return slip.velocity * (-(change / speed));
}

// A solid sphere, I = 2/5 m r²: a tangential velocity change dv through a contact at arm a = s r changes its spin by
// 5/2 s (dv × n) / r, and with it the slip by 1 + 5/2 s² times dv.
FC_HOST_DEVICE inline float rolling_resistance_to_slip(float s) { return 1.0f + 2.5f * s * s; }

}  // namespace fastcollide
