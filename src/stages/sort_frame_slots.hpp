// From the bodies to the slots and back, and the slots in the order of their cells, for a frame with lists of its own.
#pragma once

#include "advance.hpp"
#include "frame_lists.hpp"
#include "sort_slots.hpp"

namespace fastcollide {

// Where spheres are counted into cells before they are sorted.
struct CellCounter {
  GridShape shape;
  std::uint32_t *cells, *ranks;  // of each slot; its place among those of its cell
  std::uint32_t* cell_counts;

  FC_HOST_DEVICE void count(std::int64_t slot, Vec3 position) const {
    const std::uint32_t cell = cell_hash(cell_of(position, shape), shape);
    cells[slot] = cell;
    ranks[slot] = atomic_add(cell_counts + cell, 1);
  }
};

// Writes the last state of a frame to the other copy of the slots and, where there is a next one, begins it: the
// reference solver flies.
struct ToNextFrame {
  SlotState to;
  CellCounter counter;
  AdvanceSphere advance;
  bool must_advance, is_last;
  const FrameControl* control;

  FC_HOST_DEVICE void assume_walls() {
    fastcollide::assume_walls(counter.shape);
    fastcollide::assume_walls(advance.box);
  }
  FC_HOST_DEVICE void write(std::int64_t slot, const Sphere& sphere, Vec3 position, Vec3 velocity, Vec3 spin) const {
    if (must_advance && !is_last) {
      AdvanceSphere next = advance;
      next.frame = control->frame + 1;
      next(sphere.id, sphere.radius, sphere.mass, sphere.restitution, position, velocity);
    }
    to.position_radius[slot] = {position.x, position.y, position.z, sphere.radius};
    to.velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, sphere.restitution};
    if (to.spins != nullptr) to.spins[slot] = spin;
    if (!is_last) counter.count(slot, position);
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t slot, const Sphere&, float value) const { to.crowding[slot] = value; }
};

// control->frame is one before 0 here.
struct LoadFrameSlots {
  bool is_new;  // slots that hold nothing yet
  BodyArrays bodies;
  SlotConstants constants;
  ToNextFrame output;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t id = is_new ? static_cast<std::uint32_t>(slot) : constants.ids[slot];
    const Sphere sphere{bodies.positions[id],    bodies.radii[id],  bodies.velocities[id],
                        bodies.restitutions[id], bodies.masses[id], id};
    constants.ids[slot] = id;
    constants.masses[slot] = sphere.mass;
    if (output.to.crowding != nullptr) output.to.crowding[slot] = bodies.crowding[id];
    Vec3 spin{0, 0, 0};
    if (output.to.spins != nullptr) {
      spin = bodies.spins[id];
      constants.frictions[slot] = bodies.frictions[id];
    }
    output.write(slot, sphere, sphere.position, sphere.velocity, spin);
  }
};

struct ScatterFrameSlots {
  const std::uint32_t *cells, *ranks, *cell_start;
  SkinLaw law;
  SlotState from, to;
  SlotConstants from_constants, to_constants;
  Vec4* built;
  std::uint32_t* list_counts;
  FrameControl* control;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t place = cell_start[cells[slot]] + ranks[slot];
    const Vec4 here = from.position_radius[slot], velocity = from.velocity_restitution[slot];
    to.position_radius[place] = here;
    to.velocity_restitution[place] = velocity;
    built[place] = {here.x, here.y, here.z, here.w + law.skin_of({velocity.x, velocity.y, velocity.z})};
    to_constants.ids[place] = from_constants.ids[slot];
    to_constants.masses[place] = from_constants.masses[slot];
    if (from.crowding != nullptr) to.crowding[place] = from.crowding[slot];
    if (from.spins != nullptr) {
      to.spins[place] = from.spins[slot];
      to_constants.frictions[place] = from_constants.frictions[slot];
    }
    list_counts[place] = 0;
    if (slot > 0) return;
    ++control->frame;
    control->next_slot = control->next_chunk = 0;
    control->stray_records[0] = control->stray_records[1] = control->stray_records[2] = 0;
  }
};

// Bodies stay as they were where something went wrong on the way.
struct StoreFrameBodies {
  StoreBodies store;
  const FrameControl* control;
  std::uint32_t list_places, stray_places;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const bool is_fine = control->watch.first_fault == no_fault && control->longest <= list_places &&
                         control->most_stray_records <= stray_places;
    if (is_fine) store(slot);
  }
};

}  // namespace fastcollide
