// Friction that remembers: the slip of two surfaces since they met stretches a spring, which holds a load without any
// slip. The slider of Cundall and Strack, "A discrete numerical model for granular assemblies", Géotechnique 29 (1979),
// as an impulse of one substep, in the form of the normal law: a spring and a damper, cut by the crowding. Rolling
// resistance gets the same spring: the elastic-plastic model, type C, of the paper in rolling_resistance.hpp.
#pragma once

#include "friction.hpp"
#include "rolling_resistance.hpp"
#include "soft_contact.hpp"

namespace fastcollide {

// The spring is as stiff as that of the normal. A contact alone gets all of the damper, so that slip and spin of a lone
// sphere end at once. In a crowd each contact pulls along two directions and turns the sphere as well. An impulse that
// takes the part c of a motion along with a spring is stable for c < 4 / (2 + spring) = 1.23; with this factor the
// largest c of normal, slide and spin together is 1.05 between two fixed neighbours at a right angle, 1.23 between six
// and 1.18 between twelve all around. With 1 instead it is 1.5, 1.57 and 1.57, and spheres in a pile shake.
inline constexpr float crowding_of_slide = 4.0f;

// As 1 / crowding is for the normal: which part of what a contact wants to change it may change.
FC_HOST_DEVICE inline float tangential_part(float crowding) {
  return 1.0f / larger(1.0f, crowding_of_slide * (crowding - 1.0f) + 1.0f);
}

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

// slip: of this substep, with its gravity; before: without, which is how the surfaces have moved since the last one.
// The spring holds no more than friction times `push`, the normal change that the normal's spring makes; spring and
// damper together no more than friction times normal_change.
FC_HOST_DEVICE inline Hold hold(const Slip& slip, const Slip& before, Vec3 stretch, Vec3 normal, float push,
                                float normal_change, float friction, float part, float substep) {
  const float time = substep / spring;
  const Vec3 moved = laid_into_plane(stretch, normal) + before.velocity * substep;
  const Vec3 kept = cut_to(moved, friction * push * slip.resistance * (time / part));
  return {friction_change({slip.velocity + kept * (1.0f / time), slip.resistance}, normal_change, friction, part),
          kept};
}

// Of the tangential part, what rolling resistance gets: it turns a sphere that friction turns too. The springs of both
// at a lone contact on a wall are stable up to 0.3.
inline constexpr float part_of_roll = 0.25f;

// Likewise what rolling resistance does to a relative spin [rad/s]; lever: rolling_friction as the change of relative
// spin by a unit of normal change [rad/m].
FC_HOST_DEVICE inline Hold hold_roll(Vec3 spin, Vec3 stretch, float push, float normal_change, float lever, float part,
                                     float substep) {
  const float time = substep / spring, own_part = part_of_roll * part;
  const Vec3 kept = cut_to(stretch + spin * substep, lever * push * (time / own_part));
  return {brake(spin + kept * (1.0f / time), lever * normal_change, own_part), kept};
}

}  // namespace fastcollide
