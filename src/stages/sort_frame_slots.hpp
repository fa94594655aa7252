// From the bodies to the slots and back, and the slots in the order of their cells, for a frame with lists of its own.
#pragma once

#include "advance.hpp"
#include "frame_lists.hpp"
#include "sort_slots.hpp"

namespace fastcollide {

// Where spheres are counted into cells before they are sorted. Nobody waits here for what a count was: the sort takes
// the places of a cell from the last one down, which leaves all counts at zero.
struct CellCounter {
  GridShape shape;
  std::uint32_t* cells;  // of each slot
  std::uint32_t* cell_counts;

  FC_HOST_DEVICE void count(std::int64_t slot, Vec3 position) const {
    const std::uint32_t cell = cell_hash(cell_of(position, shape), shape);
    cells[slot] = cell;
    atomic_add(cell_counts + cell, 1);
  }
  FC_HOST_DEVICE std::uint32_t take_place(std::uint32_t cell) const { return atomic_add(cell_counts + cell, ~0u) - 1; }
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
  FC_HOST_DEVICE void write(std::int64_t slot, const Sphere& sphere, Vec3 position, Vec3 velocity,
                            const Spin& spin) const {
    if (must_advance && !is_last) {
      AdvanceSphere next = advance;
      next.frame = control->next_frame;
      next(sphere.id, sphere.radius, sphere.mass, sphere.restitution, position, velocity);
    }
    to.position_radius[slot] = {position.x, position.y, position.z, sphere.radius};
    to.velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, sphere.restitution};
    if (to.spins != nullptr) to.spins[slot] = spin;
    if (!is_last) counter.count(slot, position);
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t slot, const Sphere&, float value) const { to.crowding[slot] = value; }
};

// Writes to the other copy of the slots between two frames of the reference solver that have the same lists: the next
// one begins with its flight.
struct ToFlyingSlots : ToFrameSlots {
  AdvanceSphere advance;
  std::uint32_t next_frame;  // of those with the same lists

  FC_HOST_DEVICE void assume_walls() {
    ToFrameSlots::assume_walls();
    fastcollide::assume_walls(advance.box);
  }
  FC_HOST_DEVICE void write(std::int64_t slot, const Sphere& sphere, Vec3 position, Vec3 velocity,
                            const Spin& spin) const {
    AdvanceSphere next = advance;
    next.frame = strays.control->frame + next_frame;
    next(sphere.id, sphere.radius, sphere.mass, sphere.restitution, position, velocity);
    ToFrameSlots::write(slot, sphere, position, velocity, spin);
  }
};

struct ScatterFrameSlots {
  std::uint32_t frames;  // with the lists that will be made
  CellCounter counter;
  const std::uint32_t* cell_start;
  SkinLaw law;
  SlotMove move;
  Vec4* built;
  std::uint32_t* list_counts;
  Drift drift;
  FrameControl* control;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t cell = counter.cells[slot], place = cell_start[cell] + counter.take_place(cell);
    const Vec4 here = move.from.position_radius[slot];
    move(slot, place);
    const Vec3 velocity = move.velocity_of(slot);
    built[place] = {here.x, here.y, here.z, here.w + law.skin_of(velocity - control->next_drift)};
    list_counts[place] = 0;
    drift.add(slot, velocity, move.from.crowding, control);
    if (slot > 0) return;
    control->frame = control->next_frame;
    control->next_frame += frames;
    control->drift = control->next_drift;
    control->next_slot = control->next_chunk = control->next_helped = 0;
    for (auto& counts : control->near_records) counts[0] = counts[1] = 0;
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
