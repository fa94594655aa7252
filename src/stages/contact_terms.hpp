// What a contact asks of one of its two spheres in a substep, before all are added up: no branches, as compilers make
// vector instructions of it.
#pragma once

#include "substep_scratch.hpp"

namespace fastcollide {

struct ContactTerms {
  ContactGeometry contact;
  // Of one that counts, where there is gravity:
  float weight;  // in the crowding
  // Of a resting one:
  float push;    // of the spring [m/s]
  float speed;   // by which the normal velocity should change [m/s]
  float part;    // of this that it may
  float change;  // of the velocity of the sphere, along the normal [m/s]

  float met_at;     // normal velocity before this substep's gravity [m/s]
  bool is_counted;  // the two touch, or will within the next substep
  bool is_resting;  // a spring and a damper act
  bool is_impact;   // or the impulse of the pair may
};

// `self` and `neighbor` with the gravity and drag of this substep in their velocities.
FC_HOST_DEVICE inline ContactTerms contact_terms(const Substep& substep, Vec3 period, bool is_rough, const Sphere& self,
                                                 float own_crowding, const Sphere& neighbor, float other_crowding) {
  const SoftContactLaw& law = substep.law;
  const ContactGeometry contact =
      contact_geometry(self.position, self.radius, self.id, neighbor.position, neighbor.radius, neighbor.id, period);
  const Vec3 normal = contact.normal;
  const float depth = contact.depth, approach = dot(self.velocity - neighbor.velocity, normal);
  const float smaller_radius = smaller(self.radius, neighbor.radius), slop = slop_in_radii * smaller_radius;
  const bool has_gravity = law.gravity > 0.0f;
  // Surfaces that have just come apart are still damped: a contact that pops open would knock on its neighbours.
  // Four piles of 800 spheres after 15 s: v_rms 0.017 m/s with, 0.034 without.
  const bool is_closed = (depth > 0.0f) | (has_gravity & (depth + approach * law.substep > slop));
  const bool is_counted = is_closed | (has_gravity & will_close(depth, approach, law));
  const float pushed_depth = larger(depth - slop, 0.0f);
  const float weight = mass_weight(self.mass, neighbor.mass) * (is_rough ? 1.0f : load_weight(pushed_depth, law));

  const Vec3 pull = relative_gravity(substep.gravity, neighbor.mass);
  const float met_at = approach - dot(pull, normal) * law.substep;
  const bool is_fast = met_at < -law.impact_speed;
  const bool is_held_here = is_held(own_crowding), is_held_there = is_held(other_crowding);
  const bool is_impact = is_closed & is_fast & !(has_gravity & is_held_here & is_held_there);
  // Where neither is held, a fast one acts or waits as an impact.
  const bool is_resting = is_closed & has_gravity & (!is_fast | is_held_here | is_held_there);

  const float crowding = larger(fabsf(own_crowding), fabsf(other_crowding));
  const float push = resting_push(pushed_depth, smaller_radius, crowding, law);
  const float speed = push - approach, part = 1.0f / larger(1.0f, crowding);
  const float share = mass_share(self.mass, neighbor.mass);
  return {contact, weight, push, speed, part, speed * part * share, met_at, is_counted, is_resting, is_impact};
}

// Whether contact_terms() may find one that counts; with a margin of 1e-5 for rounding. `h`: a substep [s].
FC_HOST_DEVICE inline bool may_count(const Sphere& self, const Sphere& neighbor, Vec3 period, float h) {
  const Vec3 offset = separation(self.position, neighbor.position, period);
  const float reach = (self.radius + neighbor.radius) * 1.00001f, square = dot(offset, offset);
  if (square <= reach * reach) return true;
  // Those that part are within a substep of having touched, those that come together within one of touching.
  const float distance = square_root(square), along = fabsf(dot(self.velocity - neighbor.velocity, offset));
  return (distance - reach) * distance <= along * (h * 1.00001f);
}

}  // namespace fastcollide
