// The reference solver: free flight of every sphere through one frame, and the six walls.
#pragma once

#include "../data.hpp"
#include "../physics/integrate.hpp"
#include "../physics/wall.hpp"

namespace fastcollide {

struct Advance {
  Flight flight;
  Box box;
  WallMaterial wall;
  std::uint32_t frame;
  const float* radii;
  const float* masses;
  const float* restitutions;
  Vec3* positions;
  Vec3* velocities;
  Watch* watch;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    Vec3 position = positions[i], velocity = velocities[i];
    const bool is_free = !is_fixed(masses[i]);
    if (is_free) {
      fly(position, velocity, flight);
    } else {
      position = position + velocity * flight.dt;
    }
    if (!is_finite(position) || !is_finite(velocity)) {
      atomic_min(&watch->first_fault, fault_word(frame, static_cast<std::uint32_t>(i), FaultKind::not_finite));
      return;
    }
    if (!is_in_reach(position, radii[i], box)) {
      atomic_min(&watch->first_fault, fault_word(frame, static_cast<std::uint32_t>(i), FaultKind::out_of_reach));
      return;
    }
    watch_flight(watch, position - positions[i], radii[i]);
    if (is_free) collide_with_walls(position, velocity, radii[i], restitutions[i], box, wall);
    positions[i] = place_in_box(position, radii[i], masses[i], box);
    velocities[i] = velocity;
  }
};

template <Backend B>
void advance(B& backend, const Flight& flight, const Box& box, const WallMaterial& wall, std::uint32_t frame,
             Bodies<B>& bodies, Watch* watch) {
  backend.for_each(bodies.count(),
                   Advance{flight, box, wall, frame, bodies.radii.data(), bodies.masses.data(),
                           bodies.restitutions.data(), bodies.positions.data(), bodies.velocities.data(), watch});
}

}  // namespace fastcollide
