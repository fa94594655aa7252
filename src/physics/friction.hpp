// Coulomb friction at a contact point, for spheres that turn and for such that only slide.
#pragma once

#include "contact.hpp"

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

// The more slippery of two materials decides, as the more dissipative does for the restitution.
FC_HOST_DEVICE inline float pair_friction(float a, float b) { return smaller(a, b); }

// What friction does to one sphere at a contact.
struct Rub {
  Vec3 velocity;  // change of its velocity [m/s]
  Vec3 turn;      // change of its spin times its radius [m/s]
};

// How the surfaces of a pair slip: seen from a, so that the other way round every bit is the same but for the sign.
struct PairSlip {
  float arm;  // in radii
  Vec3 turning;

  FC_HOST_DEVICE PairSlip(const Sphere& a, const Sphere& b, Vec3 spin_a, Vec3 spin_b, float depth) {
    const float reach = a.radius + b.radius;
    arm = (reach - depth) / reach;
    turning = (spin_a * a.radius + spin_b * b.radius) * arm;
  }
  FC_HOST_DEVICE Slip at(Vec3 relative_velocity, Vec3 normal) const {
    return slip_at(relative_velocity, normal, turning, rolling_resistance_to_slip(arm));
  }
  FC_HOST_DEVICE Rub rub(Vec3 own_change, Vec3 normal) const {
    return {own_change, cross(own_change, normal) * (2.5f * arm)};
  }
};

// A wall rubs a sphere that does not turn (in a world without spins) or that does.
struct WallSlip {
  bool can_turn;
  Vec3 turning;

  FC_HOST_DEVICE WallSlip(float radius, Vec3 spin, bool can_turn)
      : can_turn(can_turn), turning(can_turn ? spin * radius : Vec3{0, 0, 0}) {}
  FC_HOST_DEVICE Slip at(Vec3 velocity, Vec3 normal) const {
    return slip_at(velocity, normal, turning, can_turn ? rolling_resistance_to_slip(1.0f) : 1.0f);
  }
  FC_HOST_DEVICE Rub rub(Vec3 change, Vec3 normal) const {
    return {change, cross(change, normal) * (can_turn ? 2.5f : 0.0f)};
  }
};

// normal_change: of the relative velocity along the normal, by the contact; the share of this sphere in it is by mass.
FC_HOST_DEVICE inline Rub rub_pair(const Sphere& a, const Sphere& b, Vec3 spin_a, Vec3 spin_b, Vec3 relative_velocity,
                                   const ContactGeometry& contact, float normal_change, float friction, float part) {
  const PairSlip slip(a, b, spin_a, spin_b, contact.depth);
  const Vec3 change = friction_change(slip.at(relative_velocity, contact.normal), normal_change, friction, part);
  return slip.rub(change * mass_share(a.mass, b.mass), contact.normal);
}

FC_HOST_DEVICE inline Rub rub_wall(float radius, Vec3 spin, bool can_turn, Vec3 velocity, Vec3 normal,
                                   float normal_change, float friction, float part) {
  const WallSlip slip(radius, spin, can_turn);
  return slip.rub(friction_change(slip.at(velocity, normal), normal_change, friction, part), normal);
}

}  // namespace fastcollide
