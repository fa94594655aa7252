// The reference solver: free flight of every sphere through one frame, and the six walls.
#pragma once

#include "../physics/integrate.hpp"
#include "../physics/wall.hpp"
#include "neighbors.hpp"

namespace fastcollide {

struct AdvanceSphere {
  Flight flight;
  Box box;
  WallMaterial wall;
  std::uint32_t frame;
  Watch* watch;

  // True when the sphere is where it can be; else nothing is changed and the fault is told.
  FC_HOST_DEVICE bool operator()(std::uint32_t id, float radius, float mass, float restitution, Vec3& position,
                                 Vec3& velocity) const {
    Vec3 next = position, next_velocity = velocity;
    const bool is_free = !is_fixed(mass);
    if (is_free) {
      fly(next, next_velocity, flight);
    } else {
      next = next + velocity * flight.dt;
    }
    if (!is_finite(next) || !is_finite(next_velocity)) {
      atomic_min(&watch->first_fault, fault_word(frame, id, FaultKind::not_finite));
      return false;
    }
    if (!is_in_reach(next, radius, box)) {
      atomic_min(&watch->first_fault, fault_word(frame, id, FaultKind::out_of_reach));
      return false;
    }
    watch_flight(watch, id, next - position, radius);
    if (is_free) collide_with_walls(next, next_velocity, radius, restitution, box, wall);
    position = place_in_box(next, radius, mass, box);
    velocity = next_velocity;
    return true;
  }
};

struct AdvanceBodies {
  AdvanceSphere advance;
  const float* radii;
  const float* masses;
  const float* restitutions;
  Vec3* positions;
  Vec3* velocities;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    Vec3 position = positions[i], velocity = velocities[i];
    const auto id = static_cast<std::uint32_t>(i);
    if (!advance(id, radii[i], masses[i], restitutions[i], position, velocity)) return;
    positions[i] = position;
    velocities[i] = velocity;
  }
};

template <Backend B>
void advance(B& backend, const Flight& flight, const Box& box, const WallMaterial& wall, std::uint32_t frame,
             Bodies<B>& bodies, Watch* watch) {
  backend.for_each(bodies.count(), AdvanceBodies{{flight, box, wall, frame, watch},
                                                 bodies.radii.data(),
                                                 bodies.masses.data(),
                                                 bodies.restitutions.data(),
                                                 bodies.positions.data(),
                                                 bodies.velocities.data()});
}

}  // namespace fastcollide
