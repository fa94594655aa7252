// What all contacts of a substep do to each sphere, and whom it hits.
#pragma once

#include "substep_scratch.hpp"

namespace fastcollide {

struct GatherContacts {
  SoftContactLaw law;
  FixedPoint fixed, velocity_fixed;
  Box box;
  Vec3 gravity;
  float wall_friction;
  std::uint32_t frame;
  GridView grid;
  const float* frictions;  // or null
  const float* crowding;
  float* next_crowding;
  Vec3* velocity_change;
  Vec3* turn;  // or null
  std::uint32_t* pick;
  std::uint64_t* first_fault;

  // The fastest approach wins, then the smaller id: an order that is the same for both spheres of a pair.
  struct Fastest {
    float normal_velocity;
    std::uint32_t slot = no_pick, id = no_pick;
  };

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const Sphere self = sphere_in_slot(grid, slot);
    const float own_crowding = crowding[self.id];
    const Vec3 spin = grid.spins == nullptr ? Vec3{0, 0, 0} : grid.spins[slot];
    ExactSum3 change, turned;
    CrowdingSum crowd;
    Fastest fastest{-law.impact_speed};
    std::int64_t contacts = 0;
    bool in_range = true;
    auto visit = [&](std::int64_t other) {
      if (!is_near(self, grid, other, law.opening_margin)) return;
      const Sphere neighbor = sphere_in_slot(grid, other);
      const PairGeometry pair = pair_geometry(self, neighbor, grid.period);
      const float smaller_radius = smaller(self.radius, neighbor.radius), slop = slop_in_radii * smaller_radius;
      const float depth = pair.contact.depth, approach = pair.normal_velocity;
      // Surfaces that have just come apart are still damped: a contact that pops open would knock on its neighbours.
      const bool was_closed = law.gravity > 0.0f && depth + approach * law.substep > slop;
      if (depth <= 0.0f && !was_closed) return;
      ++contacts;
      const float other_crowding = crowding[neighbor.id], crowding_here = larger(own_crowding, other_crowding);
      const bool is_fast = approach < -law.impact_speed;
      const bool both_held = own_crowding > 0.0f && other_crowding > 0.0f;
      if (is_fast && (law.gravity == 0.0f || !both_held)) {
        const bool is_first =
            approach < fastest.normal_velocity || (approach == fastest.normal_velocity && neighbor.id < fastest.id);
        if (is_first) fastest = {approach, static_cast<std::uint32_t>(other), neighbor.id};
      }
      if (law.gravity == 0.0f || (is_fast && crowding_here == 0.0f)) return;
      const float pushed_depth = larger(depth - slop, 0.0f);
      const float share = neighbor.mass / (self.mass + neighbor.mass);
      const float speed = resting_speed_change(pushed_depth, approach, smaller_radius, crowding_here, law);
      const float part = 1.0f / larger(1.0f, crowding_here);
      in_range = add_exactly(change, pair.contact.normal * (speed * part * share), velocity_fixed) && in_range;
      if (const float friction = friction_between(frictions, self.id, neighbor.id); friction > 0.0f && speed > 0.0f) {
        const Rub rub = rub_pair(self, neighbor, spin, grid.spins[other], self.velocity - neighbor.velocity,
                                 pair.contact, speed * part, friction, part);
        in_range = add_exactly(change, rub.velocity, velocity_fixed) && in_range;
        in_range = add_exactly(turned, rub.turn, velocity_fixed) && in_range;
      }
      const float weight = mass_weight(self.mass, neighbor.mass) * load_weight(pushed_depth, law);
      add_contact(crowd, pair.contact.normal, weight, fixed);
    };
    visit_neighbor_cells(grid, slot, self.position, visit);

    auto visit_wall = [&](Vec3 normal, float depth, bool) {
      if (law.gravity == 0.0f || depth <= -law.impact_speed * law.substep) return;
      const float approach = dot(self.velocity, normal);
      const float approach_before_gravity = approach - dot(gravity, normal) * law.substep;
      if (own_crowding <= 0.0f && approach_before_gravity < -law.impact_speed) return;  // an impact: see ApplyContacts
      const float closing = depth / law.substep - approach;  // > 0: in touch at the end of the substep
      if (depth <= 0.0f && closing <= 0.0f) return;
      add_contact(crowd, normal, load_weight(larger(depth, 0.0f), law), fixed);
      const float part = 1.0f / larger(1.0f, own_crowding);
      const float speed =
          (depth > 0.0f ? resting_speed_change(depth, approach, self.radius, own_crowding, law) : closing) * part;
      in_range = add_exactly(change, normal * speed, velocity_fixed) && in_range;
      if (wall_friction > 0.0f && speed > 0.0f) {
        const Rub rub =
            rub_wall(self.radius, spin, grid.spins != nullptr, self.velocity, normal, speed, wall_friction, part);
        in_range = add_exactly(change, rub.velocity, velocity_fixed) && in_range;
        in_range = add_exactly(turned, rub.turn, velocity_fixed) && in_range;
      }
    };
    visit_walls(self.position, self.radius, box, visit_wall);

    if (!in_range) atomic_min(first_fault, fault_word(frame, self.id, FaultKind::out_of_range));
    if (contacts > max_terms) atomic_min(first_fault, fault_word(frame, self.id, FaultKind::too_many_contacts));
    velocity_change[slot] = value_of(change, velocity_fixed);
    if (turn != nullptr) turn[slot] = value_of(turned, velocity_fixed);
    next_crowding[self.id] = crowding_of(crowd, fixed);
    pick[slot] = fastest.slot;
  }
};

template <Backend B>
void gather_contacts(B& backend, const SoftContactLaw& law, FixedPoint velocity_scale, const Box& box, Vec3 gravity,
                     const WallMaterial& wall, std::uint32_t frame, const Grid<B>& grid, const Bodies<B>& bodies,
                     SubstepScratch<B>& scratch, std::uint64_t* first_fault) {
  scratch.turn.resize(bodies.is_rough ? bodies.count() : 0);
  backend.for_each(
      bodies.count(),
      GatherContacts{law, crowding_scale(), velocity_scale, box, gravity, wall.friction, frame, view_of(grid),
                     bodies.frictions.data(), scratch.crowding.data(), scratch.next_crowding.data(),
                     scratch.velocity_change.data(), scratch.turn.data(), scratch.pick.data(), first_fault});
}

}  // namespace fastcollide
