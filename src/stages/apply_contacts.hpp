// Applies what was gathered: resting contacts, the impact of two spheres that picked each other, walls, flight.
#pragma once

#include <utility>

#include "substep_scratch.hpp"

namespace fastcollide {

struct ApplyContacts {
  SoftContactLaw law;
  Box box;
  Vec3 gravity;
  WallMaterial wall;
  std::uint32_t frame;
  GridView grid;
  const float* frictions;  // or null
  const float* crowding;   // that GatherContacts read
  const Vec3* velocity_change;
  const Vec3* turn;  // or null
  const std::uint32_t* pick;
  Vec3* positions;
  Vec3* velocities;
  Vec3* spins;  // or null
  std::uint64_t* first_fault;

  FC_HOST_DEVICE static bool is_zero(Vec3 a) { return a.x == 0.0f && a.y == 0.0f && a.z == 0.0f; }

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const Sphere self = sphere_in_slot(grid, slot);
    Vec3 position = self.position, velocity = self.velocity + velocity_change[slot];
    Vec3 spin = spin_after_resting(slot, self.radius);
    bool is_free = is_zero(velocity_change[slot]);
    const std::uint32_t partner = pick[slot];
    if (partner != no_pick && pick[partner] == static_cast<std::uint32_t>(slot)) {
      collide(slot, partner, position, velocity, spin);
      is_free = false;
    }
    auto visit_wall = [&](Vec3 normal, float depth, bool is_floor) {
      collide_with_wall(self, normal, depth + dot(self.position - position, normal),
                        is_floor ? wall.floor_restitution : self.restitution, position, velocity, spin, is_free);
    };
    visit_walls(self.position, self.radius, box, visit_wall);

    position = position + velocity * law.substep;
    // Velocity already holds this substep's gravity; the parabola of free flight has half of it.
    if (is_free) position = position - gravity * (0.5f * law.substep * law.substep);
    if (!is_finite(position) || !is_finite(velocity)) {
      atomic_min(first_fault, fault_word(frame, self.id, FaultKind::not_finite));
      return;
    }
    if (!is_in_reach(position, self.radius, box)) {
      atomic_min(first_fault, fault_word(frame, self.id, FaultKind::out_of_reach));
    }
    positions[self.id] = keep_inside(position, self.radius * (1.0f - deepest_push_in_radii), box);
    velocities[self.id] = velocity;
    if (spins != nullptr) spins[self.id] = spin;
  }

  FC_HOST_DEVICE Vec3 spin_after_resting(std::int64_t slot, float radius) const {
    return turn == nullptr ? Vec3{0, 0, 0} : grid.spins[slot] + turn[slot] * (1.0f / radius);
  }

  // The pair's impulse gives the normal velocity -e times that of the approach, whatever resting contacts did
  // meanwhile. Two spheres that nothing else touches get it at the very time of touching.
  FC_HOST_DEVICE void collide(std::int64_t slot, std::int64_t partner, Vec3& position, Vec3& velocity,
                              Vec3& spin) const {
    const Sphere self = sphere_in_slot(grid, slot), other = sphere_in_slot(grid, partner);
    const Vec3 own_change = velocity_change[slot], other_change = velocity_change[partner];
    const Vec3 offset = separation(self.position, other.position, grid.period);
    const Vec3 relative = self.velocity - other.velocity;
    const bool is_alone = is_zero(own_change) && is_zero(other_change);
    const PairGeometry pair = pair_geometry(self, other, grid.period);
    ContactGeometry contact = pair.contact;
    float approach = pair.normal_velocity, time_since = 0.0f;
    if (is_alone) {
      // |offset - relative t| = r_1 + r_2
      const float reach = self.radius + other.radius;
      const float speed_squared = dot(relative, relative), along = dot(offset, relative);
      const float root = along * along - speed_squared * (dot(offset, offset) - reach * reach);
      time_since = smaller((along + square_root(larger(root, 0.0f))) / speed_squared, 2.0f * law.substep);
      const Vec3 touching = offset - relative * time_since;
      const float distance = length(touching);
      if (distance > 1e-18f) {
        contact = {{touching.x / distance, touching.y / distance, touching.z / distance}, reach - distance};
        approach = smaller(dot(relative, contact.normal), 0.0f);
      }
    }
    const float bounce = -pair_restitution(self.restitution, other.restitution) * approach;
    const Vec3 relative_now = relative + (own_change - other_change);
    const float impulse = larger(bounce - dot(relative_now, contact.normal), 0.0f);
    const float share = other.mass / (self.mass + other.mass);
    Vec3 change = contact.normal * (impulse * share);
    if (const float friction = friction_between(frictions, self.id, other.id); friction > 0.0f) {
      const Rub rub = rub_pair(self, other, spin, spin_after_resting(partner, other.radius), relative_now, contact,
                               impulse, friction, 1.0f);
      change = change + rub.velocity;
      spin = spin + rub.turn * (1.0f / self.radius);
    }
    velocity = velocity + change;
    if (is_alone) position = position + change * time_since;
  }

  // A wall gives its restitution to a sphere that no resting contact held, at the very time of touching.
  FC_HOST_DEVICE void collide_with_wall(const Sphere& self, Vec3 normal, float depth, float restitution, Vec3& position,
                                        Vec3& velocity, Vec3& spin, bool& is_free) const {
    if (depth <= 0.0f) return;
    const float pull = dot(gravity, normal);
    const float before = dot(self.velocity, normal) - pull * law.substep;
    if (!(before < -law.impact_speed) || crowding[self.id] > 0.0f) {
      is_free = false;
      return;
    }
    const float time_since = smaller(depth / -before, law.substep);
    const float at_touch = smaller(before - pull * time_since, 0.0f);
    const float impulse =
        larger(pull * (time_since + law.substep) - restitution * at_touch - dot(velocity, normal), 0.0f);
    const Rub rub = rub_wall(self.radius, spin, spins != nullptr, velocity, normal, impulse, wall.friction, 1.0f);
    velocity = velocity + normal * impulse + rub.velocity;
    spin = spin + rub.turn * (1.0f / self.radius);
    if (impulse > 0.0f) position = position - normal * ((1.0f + restitution) * at_touch * time_since);
    is_free = true;
  }
};

template <Backend B>
void apply_contacts(B& backend, const SoftContactLaw& law, const Box& box, Vec3 gravity, const WallMaterial& wall,
                    std::uint32_t frame, const Grid<B>& grid, Bodies<B>& bodies, SubstepScratch<B>& scratch,
                    std::uint64_t* first_fault) {
  backend.for_each(bodies.count(), ApplyContacts{law, box, gravity, wall, frame, view_of(grid), bodies.frictions.data(),
                                                 scratch.crowding.data(), scratch.velocity_change.data(),
                                                 scratch.turn.data(), scratch.pick.data(), bodies.positions.data(),
                                                 bodies.velocities.data(), bodies.spins.data(), first_fault});
  std::swap(scratch.crowding, scratch.next_crowding);
}

}  // namespace fastcollide
