// From the bodies to the slots and back, and the slots in the order of the cells of all levels, for a pass that looks
// for neighbours in them.
#pragma once

#include "advance.hpp"
#include "level_neighbors.hpp"
#include "sort_slots.hpp"

namespace fastcollide {

// What the device tells the host about a run of frames.
struct LevelControl {
  Watch watch;
};

// Where spheres are counted into cells before they are sorted.
struct LevelCounter {
  CellLevels levels;
  std::uint32_t *cells, *ranks;  // of each slot; its place among those of its cell
  std::uint32_t* cell_counts;

  FC_HOST_DEVICE void count(std::int64_t slot, Vec3 position, float radius) const {
    const std::uint32_t cell = cell_of_sphere(position, radius, levels);
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

  FC_HOST_DEVICE void write(std::int64_t slot, const Sphere& sphere, Vec3 position, Vec3 velocity, Vec3 spin) const {
    if (must_advance) advance(sphere.id, sphere.radius, sphere.mass, sphere.restitution, position, velocity);
    to.position_radius[slot] = {position.x, position.y, position.z, sphere.radius};
    to.velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, sphere.restitution};
    if (to.spins != nullptr) to.spins[slot] = spin;
    if (must_count) counter.count(slot, position, sphere.radius);
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t slot, const Sphere&, float value) const { to.crowding[slot] = value; }
};

struct LoadLevelSlots {
  bool is_new;  // slots that hold nothing yet
  BodyArrays bodies;
  SlotConstants constants;
  ToNextPass output;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t id = is_new ? static_cast<std::uint32_t>(slot) : constants.ids[slot];
    const Sphere sphere{bodies.positions[id],    bodies.radii[id],  bodies.velocities[id],
                        bodies.restitutions[id], bodies.masses[id], id};
    constants.ids[slot] = id;
    constants.masses[slot] = sphere.mass;
    if (constants.frictions != nullptr) constants.frictions[slot] = bodies.frictions[id];
    if (output.to.crowding != nullptr) output.to.crowding[slot] = bodies.crowding[id];
    output.write(slot, sphere, sphere.position, sphere.velocity,
                 output.to.spins == nullptr ? Vec3{0, 0, 0} : bodies.spins[id]);
  }
};

struct ScatterLevelSlots {
  const std::uint32_t *cells, *ranks, *cell_start;
  SlotState from, to;
  SlotConstants from_constants, to_constants;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t place = cell_start[cells[slot]] + ranks[slot];
    to.position_radius[place] = from.position_radius[slot];
    to.velocity_restitution[place] = from.velocity_restitution[slot];
    to_constants.ids[place] = from_constants.ids[slot];
    to_constants.masses[place] = from_constants.masses[slot];
    if (from.crowding != nullptr) to.crowding[place] = from.crowding[slot];
    if (from.spins != nullptr) {
      to.spins[place] = from.spins[slot];
      to_constants.frictions[place] = from_constants.frictions[slot];
    }
  }
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
