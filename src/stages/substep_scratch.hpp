// What the stages of the default solver share.
#pragma once

#include "../data.hpp"
#include "../physics/friction.hpp"
#include "../physics/soft_contact.hpp"
#include "../physics/wall.hpp"

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

// Most candidates of the 27 cells end here: no more than place and radius are read of them.
FC_HOST_DEVICE inline bool is_near(const Sphere& self, const GridView& grid, std::int64_t other, float margin) {
  const Vec4 there = grid.position_radius[other];
  const Vec3 offset = separation(self.position, {there.x, there.y, there.z}, grid.period);
  const float reach = self.radius + there.w + margin;
  return dot(offset, offset) <= reach * reach;
}

// A world without friction has no array of it.
FC_HOST_DEVICE inline float friction_between(const float* frictions, std::uint32_t a, std::uint32_t b) {
  return frictions == nullptr ? 0.0f : pair_friction(frictions[a], frictions[b]);
}

}  // namespace fastcollide
