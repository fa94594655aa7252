// Where a contact pass finds the spheres near one, and where it writes what became of it.
#pragma once

#include "../backend/lane.hpp"
#include "../data.hpp"

namespace fastcollide {

// How a contact pass is run: as two steps, so that lanes can add up what they gathered in between.
template <class Pass>
FC_HOST_DEVICE inline void run_alone(const Pass& pass, std::int64_t slot) {
  pass.finish(slot, pass.gather(slot, Lane{}));
}

// Writes to the bodies, in the order of the ids.
struct ToBodies {
  Vec3* positions;
  Vec3* velocities;
  Vec3* spins;      // or null: they do not change
  float* crowding;  // or null: of the default solver

  FC_HOST_DEVICE void write(std::int64_t, const Sphere& sphere, Vec3 position, Vec3 velocity, const Spin& spin) const {
    positions[sphere.id] = position;
    velocities[sphere.id] = velocity;
    if (spins != nullptr) spins[sphere.id] = spin.rate;
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t, const Sphere& sphere, float value) const {
    crowding[sphere.id] = value;
  }
};

FC_HOST_DEVICE inline Spin spin_in_slot(const GridView& grid, std::int64_t slot) {
  return grid.spins == nullptr ? Spin{} : grid.spins[slot];
}

}  // namespace fastcollide
