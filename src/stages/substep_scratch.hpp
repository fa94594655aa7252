// What the stages of the default solver share.
#pragma once

#include "../physics/friction.hpp"
#include "../physics/integrate.hpp"
#include "../physics/rolling_resistance.hpp"
#include "../physics/soft_contact.hpp"
#include "../physics/wall.hpp"
#include "neighbors.hpp"

namespace fastcollide {

// All that one substep needs to know besides the spheres.
struct Substep {
  SoftContactLaw law;
  Flight flight;
  Vec3 gravity;
  Box box;
  WallMaterial wall;
  FixedPoint velocity_scale;
  std::uint32_t frame;
};

// What the default solver keeps from stage to stage.
template <Backend B>
struct SubstepScratch {
  explicit SubstepScratch(B& backend) : crowding(backend), velocity_change(backend), turn(backend), pick(backend) {}

  // Of each sphere, from substep to substep and from frame to frame; measured anew for spheres that were added.
  // Negative where nothing holds a sphere yet: see is_held().
  typename B::template Buffer<float> crowding;
  typename B::template Buffer<Vec3> velocity_change;  // by resting contacts, of each slot [m/s]
  typename B::template Buffer<Vec3> turn;             // likewise: change of spin times radius, in a rough world [m/s]
  typename B::template Buffer<std::uint32_t> pick;    // slot of its impact partner, of each slot
};

inline constexpr std::uint32_t no_pick = ~std::uint32_t(0);
// A fixed sphere collides with all that pick it.
inline constexpr std::uint32_t pick_of_fixed = no_pick - 1;
// In flight most touch nothing at all: what contacts did to them is not written, and nobody reads it.
inline constexpr std::uint32_t pick_of_untouched = no_pick - 2;

// A sphere with the gravity and drag of this substep already in its velocity.
FC_HOST_DEVICE inline Sphere falling_sphere(Sphere sphere, const Flight& flight) {
  if (is_fixed(sphere.mass)) return sphere;
  sphere.velocity = (sphere.velocity + flight.velocity_gain) * flight.damping;
  return sphere;
}
FC_HOST_DEVICE inline Sphere falling_sphere_in_slot(const GridView& grid, std::int64_t slot, const Flight& flight) {
  return falling_sphere(sphere_in_slot(grid, slot), flight);
}

FC_HOST_DEVICE inline bool are_near(const Sphere& a, Vec3 position, float radius, Vec3 period, float margin) {
  const Vec3 offset = separation(a.position, position, period);
  const float reach = a.radius + radius + margin_of_pair(a.radius, radius, margin);
  return dot(offset, offset) <= reach * reach;
}
// Most candidates of the 27 cells end here: no more than place and radius are read of them.
FC_HOST_DEVICE inline bool is_near(const Sphere& self, const GridView& grid, std::int64_t other, float margin) {
  const Vec4 there = grid.position_radius[other];
  return are_near(self, {there.x, there.y, there.z}, there.w, grid.period, margin);
}

// A world without friction has no array of it.
FC_HOST_DEVICE inline float friction_between(const GridView& grid, std::int64_t a, std::int64_t b) {
  return grid.spins == nullptr ? 0.0f : pair_friction(grid.spins[a].friction, grid.spins[b].friction);
}

// Where friction works on a contact as well, even one that carries little has to count in full: with three quarters,
// three rough spheres under a fourth one let go of it and caught it again in every other substep, and crept apart.
FC_HOST_DEVICE inline float load_weight_in(const GridView& grid, float depth, const SoftContactLaw& law) {
  return grid.spins == nullptr ? load_weight(depth, law) : 1.0f;
}

// Where spheres do not turn they do not roll.
FC_HOST_DEVICE inline bool resists_rolling(const Substep& substep, const GridView& grid) {
  return substep.law.rolling_friction > 0.0f && grid.spins != nullptr;
}

}  // namespace fastcollide
