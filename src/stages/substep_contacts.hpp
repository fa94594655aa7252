// The contact stages of the default solver: measure the crowding at the start of a frame; then, in each substep, gather
// what all contacts do to each sphere, and apply it.
#pragma once

#include <utility>

#include "../data.hpp"
#include "../physics/friction.hpp"
#include "../physics/soft_contact.hpp"
#include "../physics/wall.hpp"
#include "solve_contacts.hpp"

namespace fastcollide {

// What the default solver keeps from stage to stage.
template <Backend B>
struct SubstepScratch {
  explicit SubstepScratch(B& backend)
      : crowding(backend), next_crowding(backend), velocity_change(backend), turn(backend), pick(backend) {}

  typename B::template Buffer<float> crowding, next_crowding;  // of each sphere
  typename B::template Buffer<Vec3> velocity_change;           // by resting contacts, of each slot [m/s]
  typename B::template Buffer<Vec3> turn;           // likewise: change of spin times radius, in a rough world [m/s]
  typename B::template Buffer<std::uint32_t> pick;  // slot of its impact partner, of each slot
};

inline constexpr std::uint32_t no_pick = ~std::uint32_t(0);

struct PairGeometry {
  ContactGeometry contact;
  float normal_velocity;  // < 0: approaching [m/s]
};

FC_HOST_DEVICE inline PairGeometry pair_geometry(const Sphere& a, const Sphere& b, Vec3 period) {
  const ContactGeometry contact = contact_geometry(a.position, a.radius, a.id, b.position, b.radius, b.id, period);
  return {contact, dot(a.velocity - b.velocity, contact.normal)};
}

// The more slippery of two materials decides, as the more dissipative does for the restitution.
FC_HOST_DEVICE inline float pair_friction(const float* frictions, std::uint32_t a, std::uint32_t b) {
  return frictions == nullptr ? 0.0f : smaller(frictions[a], frictions[b]);
}

// What friction does to one sphere at a contact.
struct Rub {
  Vec3 velocity;  // change of its velocity [m/s]
  Vec3 turn;      // change of its spin times its radius [m/s]
};

// normal_change: of the relative velocity along the normal, by the contact; share: of this sphere in relative changes.
FC_HOST_DEVICE inline Rub rub_pair(const Sphere& a, const Sphere& b, Vec3 spin_a, Vec3 spin_b, Vec3 relative_velocity,
                                   const ContactGeometry& contact, float normal_change, float friction, float part) {
  const float reach = a.radius + b.radius, s = (reach - contact.depth) / reach;
  const Vec3 turning = (spin_a * a.radius + spin_b * b.radius) * s;
  const Slip slip = slip_at(relative_velocity, contact.normal, turning, rolling_resistance_to_slip(s));
  const float share = b.mass / (a.mass + b.mass);
  const Vec3 change = friction_change(slip, normal_change, friction, part) * share;
  return {change, cross(change, contact.normal) * (2.5f * s)};
}

// A wall rubs a sphere that does not turn (in a world without spins) or that does.
FC_HOST_DEVICE inline Rub rub_wall(float radius, Vec3 spin, bool can_turn, Vec3 velocity, Vec3 normal,
                                   float normal_change, float friction, float part) {
  const Vec3 turning = can_turn ? spin * radius : Vec3{0, 0, 0};
  const Slip slip = slip_at(velocity, normal, turning, can_turn ? rolling_resistance_to_slip(1.0f) : 1.0f);
  const Vec3 change = friction_change(slip, normal_change, friction, part);
  return {change, cross(change, normal) * (can_turn ? 2.5f : 0.0f)};
}

struct MeasureCrowding {
  SoftContactLaw law;
  FixedPoint fixed;
  Box box;
  GridView grid;
  float* crowding;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const Sphere self = sphere_in_slot(grid, slot);
    CrowdingSum sum;
    auto visit = [&](std::int64_t other) {
      const Sphere neighbor = sphere_in_slot(grid, other);
      const PairGeometry pair = pair_geometry(self, neighbor, grid.period);
      if (pair.contact.depth <= 0.0f || pair.normal_velocity < -law.impact_speed) return;
      const float weight = mass_weight(self.mass, neighbor.mass) * load_weight(pair.contact.depth, law);
      add_contact(sum, pair.contact.normal, weight, fixed);
    };
    visit_neighbor_cells(grid, slot, self.position, visit);
    auto visit_wall = [&](Vec3 normal, float depth, bool) {
      if (depth <= 0.0f || dot(self.velocity, normal) < -law.impact_speed) return;
      add_contact(sum, normal, load_weight(depth, law), fixed);
    };
    visit_walls(self.position, self.radius, box, visit_wall);
    crowding[self.id] = crowding_of(sum, fixed);
  }
};

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
      const Vec4 there = grid.position_radius[other];
      const Vec3 offset = separation(self.position, {there.x, there.y, there.z}, grid.period);
      const float reach = self.radius + there.w + law.opening_margin;
      if (dot(offset, offset) > reach * reach) return;
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
      if (const float friction = pair_friction(frictions, self.id, neighbor.id); friction > 0.0f && speed > 0.0f) {
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
      const float push =
          smaller(smaller(depth, deepest_push_in_radii * self.radius) * (spring / law.substep), fastest_push);
      const float part = 1.0f / larger(1.0f, own_crowding);
      const float speed = (depth > 0.0f ? push - approach : closing) * part;
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
    if (const float friction = pair_friction(frictions, self.id, other.id); friction > 0.0f) {
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

struct AddGravity {
  Vec3 velocity_gain;
  float damping;
  Vec3* velocities;

  FC_HOST_DEVICE void operator()(std::int64_t i) const { velocities[i] = (velocities[i] + velocity_gain) * damping; }
};

template <Backend B>
void measure_crowding(B& backend, const SoftContactLaw& law, const Box& box, const Grid<B>& grid,
                      SubstepScratch<B>& scratch) {
  const std::int64_t count = grid.ids.size();
  for (auto* buffer : {&scratch.crowding, &scratch.next_crowding}) buffer->resize(count);
  scratch.velocity_change.resize(count);
  scratch.pick.resize(count);
  if (law.gravity == 0.0f) return backend.fill_zero(scratch.crowding.data(), count);
  backend.for_each(count, MeasureCrowding{law, crowding_scale(), box, view_of(grid), scratch.crowding.data()});
}

template <Backend B>
void add_gravity(B& backend, const Flight& flight, Bodies<B>& bodies) {
  backend.for_each(bodies.count(), AddGravity{flight.velocity_gain, flight.damping, bodies.velocities.data()});
}

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
