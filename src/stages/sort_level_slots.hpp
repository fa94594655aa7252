// From the bodies to the slots and back, and the slots in the order of the cells of all levels, for a pass that looks
// for neighbours in them.
#pragma once

#include "advance.hpp"
#include "level_neighbors.hpp"
#include "sort_slots.hpp"

namespace fastcollide {

// Where spheres are counted into cells before they are sorted.
struct LevelCounter {
  const CellLevels* levels;
  std::uint32_t *cells, *ranks;  // of each slot; its place among those of its cell
  std::uint32_t* cell_counts;

  FC_HOST_DEVICE void count(std::int64_t slot, Vec3 position, float radius) const {
    const std::uint32_t cell = cell_of_sphere(position, radius, *levels);
    cells[slot] = cell;
    ranks[slot] = atomic_add(cell_counts + cell, 1);
  }
};

// Writes to the other copy of the slots and, where a pass follows, counts the cells for it. Between two frames the
// reference solver flies.
struct ToNextPass {
  SlotState to;
  LevelCounter counter;
  AdvanceSphere advance;
  bool must_advance, must_count;

  FC_HOST_DEVICE void assume_walls() { fastcollide::assume_walls(advance.box); }
  FC_HOST_DEVICE void write(std::int64_t slot, const Sphere& sphere, Vec3 position, Vec3 velocity,
                            const Spin& spin) const {
    if (must_advance) advance(sphere.id, sphere.radius, sphere.mass, sphere.restitution, position, velocity);
    to.position_radius[slot] = {position.x, position.y, position.z, sphere.radius};
    to.velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, sphere.restitution};
    if (to.spins != nullptr) to.spins[slot] = spin;
    if (must_count) counter.count(slot, position, sphere.radius);
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t slot, const Sphere&, float value) const { to.crowding[slot] = value; }
};

struct ScatterLevelSlots {
  const std::uint32_t *cells, *ranks, *cell_start;
  SlotMove move;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const { move(slot, cell_start[cells[slot]] + ranks[slot]); }
};

// Bodies stay as they were where something went wrong on the way.
struct StoreLevelBodies {
  StoreBodies store;
  const Watch* watch;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    if (watch->first_fault == no_fault) store(slot);
  }
};

}  // namespace fastcollide
