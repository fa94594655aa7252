// Applies what was gathered: resting contacts, the impact of two spheres that picked each other, walls, flight.
#pragma once

#include "contact_memory.hpp"
#include "substep_scratch.hpp"

namespace fastcollide {

template <class Output>
struct ApplyContacts {
  Substep substep;
  GridView grid;
  Output output;
  const Vec3* velocity_change;
  const Vec3* turn;  // or null
  const std::uint32_t* pick;
  Watch* watch;
  MemoryRows cleared = {};  // of a rough world: those that the next pass writes

  FC_HOST_DEVICE static bool is_zero(Vec3 a) { return a.x == 0.0f && a.y == 0.0f && a.z == 0.0f; }

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const SoftContactLaw& law = substep.law;
    const Sphere self = falling_sphere_in_slot(grid, slot, substep.flight);
    // Only where some contact pushed the sphere in the pass before has it written into its row then.
    if (cleared.rows != nullptr) {
      cleared.clear(self.id, had_resting_contacts(grid.crowding[slot]));
      cleared.table.clear(slot, grid.count);
    }
    const std::uint32_t partner = pick[slot];
    const bool is_touched = partner != pick_of_untouched;
    const Vec3 resting_change = is_touched ? velocity_change[slot] : Vec3{0, 0, 0};
    Vec3 position = self.position, velocity = self.velocity + resting_change;
    Spin spin = spin_in_slot(grid, slot);
    spin.rate = spin_after_resting(slot, self.radius, is_touched);
    if (is_fixed(self.mass)) return end_flight(slot, self, position + velocity * law.substep, velocity, spin);
    bool is_free = is_zero(resting_change);
    if (partner < pick_of_untouched &&
        (pick[partner] == static_cast<std::uint32_t>(slot) || pick[partner] == pick_of_fixed)) {
      collide(slot, partner, position, velocity, spin.rate, is_free);
    }
    auto visit_wall = [&](Vec3 normal, float depth, int side) {
      collide_with_wall(self, slot, normal, depth + dot(self.position - position, normal),
                        wall_restitution(substep.wall, side, self.restitution), position, velocity, spin.rate, is_free);
    };
    // Most spheres are farther from all walls than an impact may have moved them.
    const Vec3 moved = self.position - position;
    const float farthest = larger(larger(fabsf(moved.x), fabsf(moved.y)), fabsf(moved.z));
    if (!(deepest_in_walls(self.position, self.radius, substep.box) <= -farthest)) {
      visit_walls(self.position, self.radius, substep.box, visit_wall);
    }

    position = position + velocity * law.substep;
    // Velocity already holds this substep's gravity; the parabola of free flight has half of it.
    if (is_free) position = position - substep.gravity * (0.5f * law.substep * law.substep);
    end_flight(slot, self, position, velocity, spin);
  }

  FC_HOST_DEVICE void end_flight(std::int64_t slot, const Sphere& self, Vec3 position, Vec3 velocity,
                                 const Spin& spin) const {
    if (!is_finite(position) || !is_finite(velocity)) {
      atomic_min(&watch->first_fault, fault_word(substep.frame, self.id, FaultKind::not_finite));
      position = self.position;  // where it can be, until the end of the frame tells
      velocity = {0.0f, 0.0f, 0.0f};
    }
    if (!is_in_reach(position, self.radius, substep.box)) {
      atomic_min(&watch->first_fault, fault_word(substep.frame, self.id, FaultKind::out_of_reach));
    }
    watch_flight(watch, self.id, position - self.position, self.radius);
    const float smallest_distance = self.radius * (1.0f - deepest_push_in_radii);  // from a wall
    output.write(slot, self, place_in_box(position, smallest_distance, self.mass, substep.box), velocity, spin);
  }

  FC_HOST_DEVICE Vec3 spin_after_resting(std::int64_t slot, float radius, bool is_touched) const {
    if (turn == nullptr) return {0, 0, 0};
    return grid.spins[slot].rate + (is_touched ? turn[slot] : Vec3{0, 0, 0}) * (1.0f / radius);
  }

  // The pair's impulse gives the normal velocity -e times that of the approach, whatever resting contacts did
  // meanwhile. Two spheres that nothing else touches get it at the very time of touching. Gravity, which is in their
  // velocities already, came after that time: it counts where only one of the two feels it.
  FC_HOST_DEVICE void collide(std::int64_t slot, std::int64_t partner, Vec3& position, Vec3& velocity, Vec3& spin,
                              bool& is_free) const {
    const Sphere self = falling_sphere_in_slot(grid, slot, substep.flight);
    const Sphere other = falling_sphere_in_slot(grid, partner, substep.flight);
    const Vec3 own_change = velocity_change[slot], other_change = velocity_change[partner];
    const Vec3 offset = separation(self.position, other.position, grid.period);
    const Vec3 relative = self.velocity - other.velocity, pull = relative_gravity(substep.gravity, other.mass);
    const Vec3 before = relative - pull * substep.law.substep;
    const bool is_alone = is_zero(own_change) && is_zero(other_change);
    ContactGeometry contact = pair_geometry(self, other, grid.period).contact;
    float time_since = 0.0f;
    if (is_alone) {
      // |offset - before t| = r_1 + r_2
      const float reach = self.radius + other.radius;
      const float speed_squared = dot(before, before), along = dot(offset, before);
      const float root = along * along - speed_squared * (dot(offset, offset) - reach * reach);
      time_since = smaller((along + square_root(larger(root, 0.0f))) / speed_squared, 2.0f * substep.law.substep);
      const Vec3 touching = offset - before * time_since;
      const float distance = length(touching);
      if (distance > 1e-18f) {
        contact = {{touching.x / distance, touching.y / distance, touching.z / distance}, reach - distance};
      }
    }
    const float approach = smaller(dot(before - pull * time_since, contact.normal), 0.0f);
    const float bounce = dot(pull, contact.normal) * (time_since + substep.law.substep) -
                         pair_restitution(self.restitution, other.restitution) * approach;
    const Vec3 relative_now = relative + (own_change - other_change);
    const float impulse = larger(bounce - dot(relative_now, contact.normal), 0.0f);
    const float share = mass_share(self.mass, other.mass);
    Vec3 change = contact.normal * (impulse * share);
    const Vec3 own_spin = spin, other_spin = spin_after_resting(partner, other.radius, true);
    if (const float friction = friction_between(grid, slot, partner); friction > 0.0f) {
      const Rub rub = rub_pair(self, other, own_spin, other_spin, relative_now, contact, impulse, friction, 1.0f);
      change = change + rub.velocity;
      spin = spin + rub.turn * (1.0f / self.radius);
    }
    if (resists_rolling(substep, grid)) {
      const Vec3 turned =
          resist_rolling_of_pair(self, other, own_spin, other_spin, impulse, substep.law.rolling_friction, 1.0f);
      spin = spin + turned * (1.0f / self.radius);
    }
    velocity = velocity + change;
    if (is_alone) position = position + change * time_since;
    is_free = is_alone && is_fixed(other.mass);
  }

  // A wall gives its restitution to a sphere that no resting contact held, at the very time of touching.
  FC_HOST_DEVICE void collide_with_wall(const Sphere& self, std::int64_t slot, Vec3 normal, float depth,
                                        float restitution, Vec3& position, Vec3& velocity, Vec3& spin,
                                        bool& is_free) const {
    if (depth <= 0.0f) return;
    const SoftContactLaw& law = substep.law;
    const float pull = dot(substep.gravity, normal);
    const float before = dot(self.velocity, normal) - pull * law.substep;
    if (!bounces_off_wall(depth, before, pull, restitution, grid.crowding[slot], law)) {
      is_free = false;
      return;
    }
    const float time_since = smaller(2.0f * depth / (touching_speed(depth, before, pull) - before), law.substep);
    const float at_touch = smaller(before - pull * time_since, 0.0f);
    const float impulse =
        larger(pull * (time_since + law.substep) - restitution * at_touch - dot(velocity, normal), 0.0f);
    const Rub rub =
        rub_wall(self.radius, spin, grid.spins != nullptr, velocity, normal, impulse, substep.wall.friction, 1.0f);
    velocity = velocity + normal * impulse + rub.velocity;
    Vec3 turned = rub.turn;
    if (resists_rolling(substep, grid)) {
      turned = turned + resist_rolling_at_wall(self.radius, spin, impulse, law.rolling_friction, 1.0f);
    }
    spin = spin + turned * (1.0f / self.radius);
    if (impulse > 0.0f) position = position - normal * ((1.0f + restitution) * at_touch * time_since);
    is_free = true;
  }
};

template <Backend B>
void apply_contacts(B& backend, const Substep& substep, const Grid<B>& grid, Bodies<B>& bodies,
                    SubstepScratch<B>& scratch, const MemoryPass& memory, Watch* watch) {
  backend.for_each(bodies.count(), ApplyContacts<ToBodies>{substep, view_of(grid), to_bodies(bodies, scratch),
                                                           scratch.velocity_change.data(), scratch.turn.data(),
                                                           scratch.pick.data(), watch, memory.cleared});
}

}  // namespace fastcollide
