// What all contacts of a substep do to each sphere, and whom it hits.
#pragma once

#include "contact_memory.hpp"
#include "contact_terms.hpp"
#include "level_neighbors.hpp"
#include "substep_scratch.hpp"

namespace fastcollide {

template <class Neighbors, class Output>
struct GatherContacts {
  static constexpr bool gets_help = false;  // as SolveContacts; it gained nothing

  Substep substep;
  GridView grid;
  Neighbors neighbors;
  Output output;
  Vec3* velocity_change;
  Vec3* turn;  // or null
  std::uint32_t* pick;
  std::uint64_t* first_fault;
  MemoryPass memory = {};  // of a rough world

  // The fastest approach wins, then the smaller id: an order that is the same for both spheres of a pair.
  struct Approach {
    float normal_velocity;
    std::uint32_t slot = no_pick, id = no_pick;

    FC_HOST_DEVICE void keep_faster(const Approach& other) {
      const bool is_first =
          other.normal_velocity < normal_velocity || (other.normal_velocity == normal_velocity && other.id < id);
      if (is_first) *this = other;
    }
    FC_HOST_DEVICE bool is_any() const { return slot != no_pick; }
  };

  struct Sum {
    ExactSum3 change, turned;
    CrowdingSum crowd;
    Approach fastest;
    std::uint32_t contacts = 0, resting = 0, out_of_range = 0;

    FC_HOST_DEVICE bool is_empty() const { return contacts == 0; }
    FC_HOST_DEVICE void combine(const Sum& other) {
      fastcollide::add(change, other.change);
      fastcollide::add(turned, other.turned);
      fastcollide::add(crowd, other.crowd);
      fastest.keep_faster(other.fastest);
      contacts += other.contacts;
      resting += other.resting;
      out_of_range += other.out_of_range;
    }
    // All but the fastest, of few contacts, as words that are added up like integers.
    static constexpr std::uint32_t words = 13;
    FC_HOST_DEVICE void write(std::uint64_t* to) const {
      const std::int64_t sums[] = {change.x, change.y, change.z, turned.x, turned.y, turned.z,
                                   crowd.xx, crowd.yy, crowd.zz, crowd.xy, crowd.xz, crowd.yz};
      FC_UNROLL
      for (int i = 0; i < 12; ++i) to[i] = static_cast<std::uint64_t>(sums[i]);
      to[12] = contacts | std::uint64_t(resting) << 16 | std::uint64_t(out_of_range) << 32;
    }
    FC_HOST_DEVICE void add(const std::uint64_t* from) {
      std::int64_t* sums[] = {&change.x, &change.y, &change.z, &turned.x, &turned.y, &turned.z,
                              &crowd.xx, &crowd.yy, &crowd.zz, &crowd.xy, &crowd.xz, &crowd.yz};
      FC_UNROLL
      for (int i = 0; i < 12; ++i) *sums[i] += static_cast<std::int64_t>(from[i]);
      contacts += from[12] & 0xFFFF;
      resting += from[12] >> 16 & 0xFFFF;
      out_of_range += static_cast<std::uint32_t>(from[12] >> 32);
    }
  };

  template <class Others>
  FC_HOST_DEVICE GatherContacts<Others, Output> with_neighbors(const Others& others) const {
    return {substep, grid, others, output, velocity_change, turn, pick, first_fault, memory};
  }

  FC_HOST_DEVICE Sum nothing_yet() const {
    Sum sum;
    sum.fastest.normal_velocity = -substep.law.impact_speed;
    return sum;
  }

  // One of the two of a contact.
  struct Side {
    std::int64_t slot;
    Sphere sphere;
    float crowding;
    Spin spin;
  };

  FC_HOST_DEVICE Sphere load(std::int64_t slot) const { return falling_sphere_in_slot(grid, slot, substep.flight); }
  FC_HOST_DEVICE Side side_at(std::int64_t slot) const { return side_of(load(slot), slot); }
  FC_HOST_DEVICE Side side_of(const Sphere& sphere, std::int64_t slot) const {
    return {slot, sphere, grid.crowding[slot], spin_in_slot(grid, slot)};
  }

  FC_HOST_DEVICE static bool is_free(const Sphere& sphere) { return !is_fixed(sphere.mass); }
  FC_HOST_DEVICE Sum gather(std::int64_t slot, Lane lane) const { return gather(load(slot), slot, lane); }
  FC_HOST_DEVICE Sum gather(const Sphere& sphere, std::int64_t slot, Lane lane) const {
    const Side self = side_of(sphere, slot);
    Sum sum = nothing_yet();
    if (!is_free(sphere)) return sum;
    auto visit = [&](std::int64_t other) {
      if (is_near(sphere, grid, other, substep.law.opening_margin)) add_pair(self, side_at(other), sum);
    };
    neighbors.visit(grid, slot, sphere.position, lane, visit);
    if (lane.index == 0) gather_walls(self, sum);
    return sum;
  }
  // The same in parts: with one who has been found near, and what the walls do. All that the pair needs is asked for
  // at once.
  FC_HOST_DEVICE void add_near(std::int64_t slot, std::int64_t other, Sum& sum) const {
    const Side self = side_at(slot), neighbor = side_at(other);
    const Sphere& there = neighbor.sphere;
    if (are_near(self.sphere, there.position, there.radius, grid.period, substep.law.opening_margin)) {
      add_pair(self, neighbor, sum);
    }
  }
  FC_HOST_DEVICE void add_walls(const Sphere& sphere, std::int64_t slot, Sum& sum) const {
    if (is_free(sphere)) gather_walls(side_of(sphere, slot), sum);
  }

  FC_HOST_DEVICE void add_pair(const Side& self, const Side& neighbor, Sum& sum) const {
    const bool is_rough = grid.spins != nullptr;
    const ContactTerms terms =
        contact_terms(substep, grid.period, is_rough, self.sphere, self.crowding, neighbor.sphere, neighbor.crowding);
    if (!terms.is_counted) return;
    ++sum.contacts;
    if (terms.is_impact) keep_impact(neighbor.slot, terms.met_at, sum);
    if (substep.law.gravity == 0.0f) return;
    add_contact(sum.crowd, terms.contact.normal, terms.weight);
    if (!terms.is_resting) return;
    ++sum.resting;
    add_change(sum, terms.contact.normal * terms.change);
    if (is_rough) rub(self, neighbor, terms.contact, terms.push, terms.speed, terms.part, sum);
  }

  FC_HOST_DEVICE void keep_impact(std::int64_t other, float met_at, Sum& sum) const {
    sum.fastest.keep_faster({met_at, static_cast<std::uint32_t>(other), grid.mass_ids[other].id});
  }

  // push, speed and part: of the ContactTerms.
  FC_HOST_DEVICE void rub(const Side& self, const Side& neighbor, const ContactGeometry& contact, float push,
                          float speed, float part, Sum& sum) const {
    const Vec3 normal = contact.normal;
    const Sphere &here = self.sphere, &there = neighbor.sphere;
    const float normal_push = larger(push, speed) * part, normal_change = larger(speed, 0.0f) * part;
    const float own_part = tangential_part(larger(fabsf(self.crowding), fabsf(neighbor.crowding)));
    const float friction = pair_friction(self.spin.friction, neighbor.spin.friction), h = substep.law.substep;
    const bool rolls = resists_rolling(substep, grid);
    if (!(normal_push > 0.0f && (friction > 0.0f || rolls))) return;
    const bool is_owner = MemoryPass::is_owner(here, there);
    // Long before it is needed: to wait for it took 7 % of the pass.
    const std::uint32_t place = is_owner && memory.is_kept() ? memory.to.take(here.id) : 0;
    ContactStretch stretch = memory.of_pair(here, there);
    if (friction > 0.0f) {
      const PairSlip slip(here, there, self.spin.rate, neighbor.spin.rate, contact.depth);
      const Vec3 before = velocity_in_slot(grid, self.slot) - velocity_in_slot(grid, neighbor.slot);
      const Hold held = hold(slip.at(here.velocity - there.velocity, normal), slip.at(before, normal), stretch.slide,
                             normal, normal_push, normal_change, friction, own_part, h);
      stretch.slide = held.stretch;
      const Rub rub = slip.rub(held.change * mass_share(here.mass, there.mass), normal);
      add_change(sum, rub.velocity);
      add_turn(sum, rub.turn);
    }
    if (rolls) {
      const RollingPair rolling(here, there);
      const Hold held = hold_roll(self.spin.rate - neighbor.spin.rate, stretch.roll, normal_push, normal_change,
                                  substep.law.rolling_friction * rolling.lever, own_part, h);
      stretch.roll = held.stretch;
      add_turn(sum, rolling.turn(held.change));
    }
    if (is_owner && memory.is_kept()) remember(here.id, place, there.id, stretch);
  }

  FC_HOST_DEVICE void remember(std::uint32_t owner, std::uint32_t place, std::uint32_t partner,
                               const ContactStretch& stretch) const {
    if (!memory.to.put(owner, place, partner, stretch, memory.wanted)) {
      atomic_min(first_fault, fault_word(substep.frame, owner, FaultKind::memory_full));
    }
  }

  FC_HOST_DEVICE void gather_walls(const Side& here, Sum& sum) const {
    const SoftContactLaw& law = substep.law;
    const Sphere& self = here.sphere;
    const Vec3 spin = here.spin.rate;
    const float known_crowding = here.crowding, crowding = fabsf(known_crowding);
    if (law.gravity == 0.0f) return;
    const float nearest = -law.impact_speed * law.substep;
    if (deepest_in_walls(self.position, self.radius, substep.box) <= nearest) return;  // most spheres
    auto visit_wall = [&](Vec3 normal, float depth, int side) {
      if (depth <= nearest) return;
      const float approach = dot(self.velocity, normal);
      const float pull = dot(substep.gravity, normal), before = approach - pull * law.substep;
      const float restitution = wall_restitution(substep.wall, side, self.restitution);
      if (bounces_off_wall(depth, before, pull, restitution, known_crowding, law)) return;  // see ApplyContacts
      const float closing = depth / law.substep - approach;  // > 0: in touch at the end of the substep
      if (depth <= 0.0f && closing <= 0.0f) return;
      ++sum.contacts;
      ++sum.resting;
      add_contact(sum.crowd, normal, load_weight_in(grid, larger(depth, 0.0f), law));
      const float part = 1.0f / larger(1.0f, crowding);
      const float push = depth > 0.0f ? resting_push(depth, self.radius, crowding, law) : 0.0f;
      const float asked = depth > 0.0f ? push - approach : closing, speed = asked * part;
      add_change(sum, normal * speed);
      if (grid.spins != nullptr) {
        // A sphere at rest may touch a wall without reaching into it, so that no spring pushes it.
        rub_at_wall(here.slot, self, spin, normal, side, larger(push, asked) * part, larger(speed, 0.0f),
                    tangential_part(crowding), sum);
      } else if (substep.wall.friction > 0.0f && speed > 0.0f) {
        const Rub rub = rub_wall(self.radius, spin, false, self.velocity, normal, speed, substep.wall.friction, part);
        add_change(sum, rub.velocity);
      }
    };
    visit_walls(self.position, self.radius, substep.box, visit_wall);
  }

  FC_HOST_DEVICE void rub_at_wall(std::int64_t slot, const Sphere& self, Vec3 spin, Vec3 normal, int side, float push,
                                  float normal_change, float part, Sum& sum) const {
    const float friction = substep.wall.friction, h = substep.law.substep;
    const bool rolls = resists_rolling(substep, grid);
    if (!(friction > 0.0f || rolls)) return;
    const std::uint32_t wall = ContactState::first_wall + static_cast<std::uint32_t>(side);
    ContactStretch stretch = memory.of_wall(self, wall);
    if (friction > 0.0f) {
      const WallSlip slip(self.radius, spin, true);
      const Hold held = hold(slip.at(self.velocity, normal), slip.at(velocity_in_slot(grid, slot), normal),
                             stretch.slide, normal, push, normal_change, friction, part, h);
      stretch.slide = held.stretch;
      const Rub rub = slip.rub(held.change, normal);
      add_change(sum, rub.velocity);
      add_turn(sum, rub.turn);
    }
    if (rolls) {
      const float lever = substep.law.rolling_friction * 2.5f / self.radius;
      const Hold held = hold_roll(spin, stretch.roll, push, normal_change, lever, part, h);
      stretch.roll = held.stretch;
      add_turn(sum, held.change * self.radius);
    }
    if (!stretch.is_none() && memory.is_kept()) remember(self.id, memory.to.take(self.id), wall, stretch);
  }

  FC_HOST_DEVICE void finish(std::int64_t slot, const Sum& sum) const { finish(load(slot), slot, sum); }
  FC_HOST_DEVICE void finish(const Sphere& self, std::int64_t slot, const Sum& sum) const {
    if (sum.out_of_range > 0) atomic_min(first_fault, fault_word(substep.frame, self.id, FaultKind::out_of_range));
    if (sum.contacts > max_terms) {
      atomic_min(first_fault, fault_word(substep.frame, self.id, FaultKind::too_many_contacts));
    }
    const bool is_touched = sum.contacts > 0 || is_fixed(self.mass);
    if (is_touched) {
      velocity_change[slot] = value_of(sum.change, substep.velocity_scale);
      if (turn != nullptr) turn[slot] = value_of(sum.turned, substep.velocity_scale);
    }
    const float crowding = sum.contacts > 0 ? crowding_of(sum.crowd) : 0.0f;
    output.write_crowding(slot, self, sum.resting > 0 ? crowding : -crowding);
    pick[slot] = is_fixed(self.mass) ? pick_of_fixed : is_touched ? sum.fastest.slot : pick_of_untouched;
  }

  FC_HOST_DEVICE void operator()(std::int64_t slot) const { run_alone(*this, slot); }

  FC_HOST_DEVICE void add_change(Sum& sum, Vec3 change) const {
    if (!add_exactly(sum.change, change, substep.velocity_scale)) ++sum.out_of_range;
  }
  FC_HOST_DEVICE void add_turn(Sum& sum, Vec3 change) const {
    if (!add_exactly(sum.turned, change, substep.velocity_scale)) ++sum.out_of_range;
  }
};

template <Backend B>
ToBodies to_bodies(Bodies<B>& bodies, SubstepScratch<B>& scratch) {
  return {bodies.positions.data(), bodies.velocities.data(), bodies.spins.data(), scratch.crowding.data()};
}

template <Backend B>
void gather_contacts(B& backend, const Substep& substep, const Grid<B>& grid, Bodies<B>& bodies,
                     SubstepScratch<B>& scratch, const MemoryPass& memory, std::uint64_t* first_fault) {
  scratch.velocity_change.resize(bodies.count());
  scratch.pick.resize(bodies.count());
  scratch.turn.resize(bodies.is_rough ? bodies.count() : 0);
  backend.for_each(bodies.count(),
                   GatherContacts<CellNeighbors, ToBodies>{
                       substep, view_of(grid), neighbors_in(grid), to_bodies(bodies, scratch),
                       scratch.velocity_change.data(), scratch.turn.data(), scratch.pick.data(), first_fault, memory});
}

}  // namespace fastcollide
