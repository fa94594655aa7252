// Friction that remembers: the slip of two surfaces since they met stretches a spring, which holds a load without any
// slip. The slider of Cundall and Strack, "A discrete numerical model for granular assemblies", Géotechnique 29 (1979),
// as an impulse of one substep, in the form of the normal law: a spring and a damper, cut by the crowding.
#pragma once

#include "friction.hpp"
#include "rolling_resistance.hpp"
#include "soft_contact.hpp"

namespace fastcollide {

// A stretch times this per substep becomes slip the other way, as `spring` does with an overlap.
inline constexpr float tangential_spring = 1.0f;

// What a contact remembers, seen from one of the two; from the other one it is the negative.
struct ContactStretch {
  Vec3 slide;  // of the surface over the other one, along the contact plane [m]
  Vec3 roll;   // relative turn of the two [rad]

  FC_HOST_DEVICE bool is_none() const {
    return slide.x == 0.0f && slide.y == 0.0f && slide.z == 0.0f && roll.x == 0.0f && roll.y == 0.0f && roll.z == 0.0f;
  }
};

FC_HOST_DEVICE inline ContactStretch operator-(const ContactStretch& a) { return {-a.slide, -a.roll}; }

// The contact plane turns as the spheres move: the stretch is laid into it and keeps its length.
FC_HOST_DEVICE inline Vec3 laid_into_plane(Vec3 stretch, Vec3 normal) {
  const Vec3 along = stretch - normal * dot(stretch, normal);
  const float before = dot(stretch, stretch), now = dot(along, along);
  return now > 0.0f ? along * square_root(before / now) : Vec3{0, 0, 0};
}

// No longer than `longest`.
FC_HOST_DEVICE inline Vec3 cut_to(Vec3 stretch, float longest) {
  const float found = length(stretch);
  return found > longest ? stretch * (longest / found) : stretch;
}

// What friction does to a relative tangential velocity, and the stretch that is left.
struct Hold {
  Vec3 change;   // [m/s]
  Vec3 stretch;  // [m]
};

// slip: of this substep, with its gravity; before: without, which is what the surfaces have moved by since the last one.
// The spring holds no more than friction times what that of the normal, `push`, does; spring and damper together no more
// than friction times normal_change.
FC_HOST_DEVICE inline Hold hold(const Slip& slip, const Slip& before, Vec3 stretch, Vec3 normal, float push,
                                float normal_change, float friction, float part, float substep) {
  const Vec3 moved = laid_into_plane(stretch, normal) + before.velocity * substep;
  const Vec3 kept = cut_to(moved, friction * push * slip.resistance * (substep / tangential_spring));
  const Slip with_spring{slip.velocity + kept * (tangential_spring / substep), slip.resistance};
  return {friction_change(with_spring, normal_change, friction, part), kept};
}

}  // namespace fastcollide
