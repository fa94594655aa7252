// From the bodies to the slots and back, and the slots in the order of their cells.
#pragma once

#include "neighbor_lists.hpp"

namespace fastcollide {

// The bodies as plain pointers.
struct BodyArrays {
  Vec3* positions;
  Vec3* velocities;
  float* radii;
  float* masses;
  float* restitutions;
  float* crowding;   // or null
  Vec3* spins;       // or null
  float* frictions;  // or null
};

struct LoadSlots {
  bool is_new;  // slots that hold nothing yet
  BodyArrays bodies;
  MassId* mass_ids;
  SlotState state;
  ToSlots output;  // of the same state

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t id = is_new ? static_cast<std::uint32_t>(slot) : mass_ids[slot].id;
    const Vec3 position = bodies.positions[id], velocity = bodies.velocities[id];
    const float radius = bodies.radii[id];
    if (is_new) {
      output.news->is_stale = 1;
      output.built[slot] = {position.x, position.y, position.z, 1e30f};  // nothing to leave before the first lists
    } else if (state.position_radius[slot].w != radius || output.has_left(output.built[slot], position) ||
               is_fixed(mass_ids[slot].mass) != is_fixed(bodies.masses[id])) {
      // The arrays are the user's: spheres may have been moved, blown up or let loose since the lists were made.
      output.news->is_stale = 1;
    }
    state.position_radius[slot] = {position.x, position.y, position.z, radius};
    state.velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, bodies.restitutions[id]};
    mass_ids[slot] = {bodies.masses[id], id};
    if (state.crowding != nullptr) state.crowding[slot] = bodies.crowding[id];
    if (state.spins != nullptr) state.spins[slot] = {bodies.spins[id], bodies.frictions[id]};
  }
};

struct StoreBodies {
  SlotState state;
  const MassId* mass_ids;
  BodyArrays bodies;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t id = mass_ids[slot].id;
    const Vec4 a = state.position_radius[slot], b = state.velocity_restitution[slot];
    bodies.positions[id] = {a.x, a.y, a.z};
    bodies.velocities[id] = {b.x, b.y, b.z};
    if (state.crowding != nullptr) bodies.crowding[id] = state.crowding[slot];
    if (state.spins != nullptr) bodies.spins[id] = state.spins[slot].rate;
  }
};

// A counting sort by cell. Spheres of one cell may come in any order: no result depends on it.
struct CountCells {
  GridShape shape;
  const Vec4* position_radius;
  std::uint32_t* cells;
  std::uint32_t* ranks;
  std::uint32_t* cell_counts;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const Vec4 here = position_radius[slot];
    const std::uint32_t cell = cell_hash(cell_of({here.x, here.y, here.z}, shape), shape);
    cells[slot] = cell;
    ranks[slot] = atomic_add(cell_counts + cell, 1);
  }
};

// A slot on its way into another order.
struct SlotMove {
  SlotState from, to;
  const MassId* from_mass_ids;
  MassId* to_mass_ids;

  FC_HOST_DEVICE void operator()(std::int64_t slot, std::uint32_t place) const {
    to.position_radius[place] = from.position_radius[slot];
    to.velocity_restitution[place] = from.velocity_restitution[slot];
    to_mass_ids[place] = from_mass_ids[slot];
    if (from.crowding != nullptr) to.crowding[place] = from.crowding[slot];
    if (from.spins != nullptr) to.spins[place] = from.spins[slot];
  }
  FC_HOST_DEVICE Vec3 velocity_of(std::int64_t slot) const {
    const Vec4 velocity = from.velocity_restitution[slot];
    return {velocity.x, velocity.y, velocity.z};
  }
};

struct ScatterSlots {
  const std::uint32_t* cells;
  const std::uint32_t* ranks;
  const std::uint32_t* cell_start;
  SkinLaw law;
  SlotMove move;
  Vec4* built;
  std::uint32_t* sorted_cells;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t cell = cells[slot], place = cell_start[cell] + ranks[slot];
    const Vec4 here = move.from.position_radius[slot];
    move(slot, place);
    built[place] = {here.x, here.y, here.z, law.skin_of(move.velocity_of(slot))};
    sorted_cells[place] = cell;
  }
};

// From the bodies to where an output writes the state.
template <class Output>
struct LoadInto {
  bool is_new;  // slots that hold nothing yet
  BodyArrays bodies;
  MassId* mass_ids;
  Output output;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t id = is_new ? static_cast<std::uint32_t>(slot) : mass_ids[slot].id;
    const Sphere sphere{bodies.positions[id],    bodies.radii[id],  bodies.velocities[id],
                        bodies.restitutions[id], bodies.masses[id], id};
    mass_ids[slot] = {sphere.mass, id};
    if (output.to.crowding != nullptr) output.to.crowding[slot] = bodies.crowding[id];
    Spin spin{};
    if (output.to.spins != nullptr) spin = {bodies.spins[id], bodies.frictions[id]};
    output.write(slot, sphere, sphere.position, sphere.velocity, spin);
  }
};

// What the sort makes void.
struct ForgetNews {
  ListControl* control;

  FC_HOST_DEVICE void operator()(std::int64_t) const {
    control->news[0] = control->news[1] = {0, 0};
    control->longest = 0;
  }
};

// The queue of the last pass is dealt with.
struct ForgetQueue {
  ListNews* news;

  FC_HOST_DEVICE void operator()(std::int64_t) const { news->queued = 0; }
};

}  // namespace fastcollide
