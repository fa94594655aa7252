// Lists of the spheres near each one, which hold for many passes.
//
// Each sphere has a skin: how far it may move from where it stood when its list was made. Two spheres that are not in
// each other's lists stood farther apart than their radii, the reach of a pass and both skins, so no contact is missed
// while both stay in their skins. A sphere that leaves its skin is queued, and before the next pass its list is made
// anew and it is added to the lists of others. Only when many leave, or one goes far, are all sorted again.
#pragma once

#include "neighbors.hpp"

namespace fastcollide {

struct SkinLaw {
  float time;      // a list is meant to hold this long at the speed of the sphere [s]
  float thinnest;  // [m]
  float thickest;  // [m]
  float reach;     // between two surfaces, that a pass looks at [m]
  float largest_radius;

  FC_HOST_DEVICE float skin_of(Vec3 velocity) const {
    return smaller(thinnest + time * length(velocity), thickest);  // a speed that is no number gives the thickest
  }
  // From the centre of a sphere to those that its list may need.
  FC_HOST_DEVICE float search_range(float radius, float skin) const {
    return radius + largest_radius + reach + skin + thickest;
  }
};

// A sphere as a list sees it: the pair is listed when the two are within reach of each other in their skins.
struct Skinned {
  Vec3 position;
  float radius, skin;
};

FC_HOST_DEVICE inline Skinned skinned(Vec4 start, float radius) {
  return {{start.x, start.y, start.z}, radius, fabsf(start.w)};
}

// The same bits whichever of the two comes first.
FC_HOST_DEVICE inline bool are_listed(const Skinned& a, const Skinned& b, Vec3 period, float reach) {
  const Vec3 offset = separation(a.position, b.position, period);
  const float range = (a.radius + b.radius) + (a.skin + b.skin) + reach;
  return dot(offset, offset) <= range * range;
}

// Four runs of slots, one after the other.
struct Runs {
  std::uint32_t begin[4], count[4];

  FC_HOST_DEVICE std::uint32_t total() const { return count[0] + count[1] + count[2] + count[3]; }
  FC_HOST_DEVICE std::uint32_t operator()(std::uint32_t i) const {
    if (i < count[0]) return begin[0] + i;
    i -= count[0];
    if (i < count[1]) return begin[1] + i;
    i -= count[1];
    return i < count[2] ? begin[2] + i : begin[3] + (i - count[2]);
  }
};

// Calls visit(runs) for the slots in the cells that overlap position ± range; rows of cells are shared among the lanes.
// Cells count along x first: those of a row are one run, or two where the row goes round. Four rows at a time, so that
// a GPU waits once for where they start. Only the slots of a row of cells need be one behind the other.
template <class Visit>
FC_HOST_DEVICE inline void visit_runs(const GridShape& shape, const std::uint32_t* cell_start,
                                      const std::uint32_t* cell_end, Vec3 position, float range, Lane lane,
                                      Visit& visit) {
  const CellRange xs = cells_within(position.x, range, shape.x);
  const CellRange ys = cells_within(position.y, range, shape.y);
  const CellRange zs = cells_within(position.z, range, shape.z);
  const int inside = xs.first + xs.count <= shape.x.cells ? xs.count : shape.x.cells - xs.first;
  const int rows = ys.count * zs.count, parts = inside < xs.count ? 2 : 1;
  for (int part = 0; part < parts; ++part) {
    const int first = part == 0 ? xs.first : 0, cells = part == 0 ? inside : xs.count - inside;
    for (int row = lane.index; row < rows; row += 4 * lane.count) {
      Runs runs;
      FC_UNROLL
      for (int k = 0; k < 4; ++k) {
        const int here = row + k * lane.count;
        const int y = here % ys.count, z = here / ys.count;
        runs.begin[k] = runs.count[k] = 0;
        if (here < rows) {
          const Vec3i cell{first, cell_in_range(ys, y, shape.y), cell_in_range(zs, z, shape.z)};
          const std::uint32_t hash = cell_hash(cell, shape);
          runs.begin[k] = cell_start[hash];
          runs.count[k] = cell_end[hash + static_cast<std::uint32_t>(cells - 1)];
        }
      }
      FC_UNROLL
      for (int k = 0; k < 4; ++k) runs.count[k] -= runs.begin[k];
      visit(runs);
    }
  }
}

// Few of the spheres that a pass looks at are near. Places are loaded four at a time, so that a GPU waits for memory
// once and not four times, and the near ones of 32 are visited together, so that its lanes are busy at the same time.
struct NearSearch {
  static constexpr std::uint32_t at_once = 4;

  const Vec4* position_radius;
  Vec3 period, position;
  float range;

  // Within `range` plus its radius, or perhaps a little beyond.
  FC_HOST_DEVICE bool is_near(Vec4 there) const {
    const Vec3 offset = separation(position, {there.x, there.y, there.z}, period);
    const float most = (range + there.w) * 1.00001f;
    return dot(offset, offset) <= most * most;
  }
  // A bit for each that is near: those of `there` have the bits from `bit` on, as far as `end`.
  FC_HOST_DEVICE std::uint32_t near_of(const Vec4 (&there)[at_once], std::uint32_t bit, std::uint32_t end) const {
    std::uint32_t near = 0;
    FC_UNROLL
    for (std::uint32_t k = 0; k < at_once; ++k) {
      if (bit + k < end && is_near(there[k])) near |= 1u << (bit + k);
    }
    return near;
  }

  // Calls visit(other) for the near ones of `count`. The first `next` of them, 32 at most, have been looked at: `near`.
  template <class SlotAt, class Visit>
  FC_HOST_DEVICE void visit(std::uint32_t next, std::uint32_t near, std::uint32_t count, const SlotAt& slot_at,
                            Visit& visit) const {
    for (std::uint32_t begin = 0; begin < count; begin += 32) {
      const std::uint32_t end = count - begin < 32 ? count : begin + 32;
      for (; next < end; next += at_once) {
        Vec4 there[at_once];
        FC_UNROLL
        for (std::uint32_t k = 0; k < at_once; ++k) {
          there[k] = position_radius[slot_at(next + k < end ? next + k : end - 1)];
        }
        near |= near_of(there, next - begin, end - begin);
      }
      next = end;
      for (; near != 0; near &= near - 1) visit(slot_at(begin + static_cast<std::uint32_t>(lowest_bit(near))));
    }
  }
};

template <class SlotAt, class Visit>
FC_HOST_DEVICE inline void visit_near(const Vec4* position_radius, Vec3 period, Vec3 position, float range,
                                      std::uint32_t count, const SlotAt& slot_at, Visit& visit) {
  NearSearch{position_radius, period, position, range}.visit(0, 0, count, slot_at, visit);
}

// Makes the lists of all spheres, right after a sort.
struct RecordLists {
  GridShape shape;
  Vec3 period;
  const std::uint32_t* cell_start;
  const Vec4* position_radius;
  const MassId* mass_ids;
  const Vec4* built;
  SkinLaw law;
  NeighborLists lists;
  ListControl* control;

  FC_HOST_DEVICE void operator()(std::int64_t row) const {
    const std::uint32_t slot = static_cast<std::uint32_t>(row / lists.lanes);
    const Lane lane{static_cast<int>(row % lists.lanes), static_cast<int>(lists.lanes)};
    if (is_fixed(mass_ids[slot].mass)) {  // nothing pushes it, so it asks for nobody
      lists.counts[row] = {0, 0};
      return;
    }
    const Skinned self = skinned(built[slot], position_radius[slot].w);
    std::uint32_t* list = lists.of_row(row);
    std::uint32_t found = 0;
    auto record = [&](std::uint32_t other) {
      if (other == slot || !are_listed(self, skinned(built[other], position_radius[other].w), period, law.reach)) {
        return;
      }
      if (found < lists.capacity) list[std::int64_t(found) * lists.width] = other;
      ++found;
    };
    auto look_at = [&](const Runs& runs) {
      visit_near(position_radius, period, self.position, self.radius + self.skin + law.reach + law.thickest,
                 runs.total(), runs, record);
    };
    visit_runs(shape, cell_start, cell_start + 1, self.position, law.search_range(self.radius, self.skin), lane,
               look_at);
    const std::uint32_t kept = found < lists.capacity ? found : lists.capacity;
    lists.counts[row] = {kept, kept};
    if (found > lists.capacity) atomic_max(&control->longest, found);
  }
};

struct ListedNeighbors {
  NeighborLists lists;
  float reach;

  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, Visit& visit) const {
    const std::int64_t row = slot * lane.count + lane.index;
    const std::uint32_t* list = lists.of_row(row);
    const std::uint32_t count = publish(row);
    const auto slot_at = [&](std::uint32_t i) { return list[std::int64_t(i) * lists.width]; };
    visit_near(grid.position_radius, grid.period, position, grid.position_radius[slot].w + reach, count, slot_at,
               visit);
  }

  // The entries of a row; what was being added to it is there for all from now on.
  FC_HOST_DEVICE std::uint32_t publish(std::int64_t row) const {
    const ListCount count = lists.counts[row];
    if (count.published != count.pending) lists.counts[row].published = count.pending;
    return count.pending;
  }
};

// Writes to the other copy of the slots, and queues a sphere that has left its skin.
struct ToSlots {
  SlotState to;
  Vec4* built;
  Vec3 period;
  NeighborLists lists;
  SkinLaw law;
  GridShape shape;
  const std::uint32_t* cells;  // of the last sort
  QueuedSphere* queue;
  std::uint32_t queue_places;
  ListNews* news;
  bool is_repaired;  // whether the lists of all that were queued are made

  FC_HOST_DEVICE void write(std::int64_t slot, const Sphere& sphere, Vec3 position, Vec3 velocity,
                            const Spin& spin) const {
    to.position_radius[slot] = {position.x, position.y, position.z, sphere.radius};
    to.velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, sphere.restitution};
    if (to.spins != nullptr) to.spins[slot] = spin;
    const Vec4 start = built[slot];
    const bool is_queued = start.w < 0.0f && !is_repaired;
    if (has_left(start, position)) {
      leave(slot, start, position, velocity, is_queued);
    } else if (start.w < 0.0f && is_repaired) {
      built[slot].w = -start.w;
    }
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t slot, const Sphere&, float value) const { to.crowding[slot] = value; }

  // A fiftieth of the skin makes up for rounding: distances are right to a few 2^-24 and the skin is no thinner than a
  // twentieth of the largest radius. Across a periodic end, differences have the rounding of the period.
  FC_HOST_DEVICE bool has_left(Vec4 start, Vec3 position) const {
    const Vec3 moved = separation(position, {start.x, start.y, start.z}, period);
    const float most = larger(0.98f * fabsf(start.w) - 1e-6f * (period.x + period.y + period.z), 0.0f);
    return !(dot(moved, moved) <= most * most);  // also where a coordinate is no number
  }

  FC_HOST_DEVICE void leave(std::int64_t slot, Vec4 start, Vec3 position, Vec3 velocity, bool is_queued) const {
    if (!is_queued) {
      // Reads before it writes: where all leave at once, they would wait for the same word.
      if (atomic_read(&news->queued) > queue_places) return;
      const std::uint32_t place = atomic_add(&news->queued, 1);
      if (place >= queue_places) return;
      queue[place] = {{start.x, start.y, start.z, fabsf(start.w)}, static_cast<std::uint32_t>(slot)};
      for (std::uint32_t lane = 0; lane < lists.lanes; ++lane) lists.counts[slot * lists.lanes + lane] = {0, 0};
    }
    // Negative: others must not look for this sphere in its list, which is empty now.
    built[slot] = {position.x, position.y, position.z, -law.skin_of(velocity)};
    if (!is_beside(cells[slot], cell_of(position, shape))) news->is_stale = 1;
  }

  // A sphere is searched for in the cell of the last sort and the cells beside it.
  FC_HOST_DEVICE bool is_beside(std::uint32_t sorted_cell, Vec3i cell) const {
    const int xs = shape.x.cells, ys = shape.y.cells;
    const int cell_index = static_cast<int>(sorted_cell);
    return is_beside_on_axis(cell_index % xs, cell.x, shape.x) &&
           is_beside_on_axis(cell_index / xs % ys, cell.y, shape.y) &&
           is_beside_on_axis(cell_index / xs / ys, cell.z, shape.z);
  }
  FC_HOST_DEVICE static bool is_beside_on_axis(int a, int b, const GridAxis& axis) {
    const int apart = a < b ? b - a : a - b;
    return apart <= 1 || (axis.boundary != Boundary::wall && apart >= axis.cells - 1);
  }
};

// Makes the list of a queued sphere anew and adds it to the lists of those around. A warp's worth of lanes shares one.
struct RepairLists {
  GridShape shape;
  Vec3 period;
  const std::uint32_t* cell_start;
  const QueuedSphere* queue;
  const Vec4* position_radius;
  const MassId* mass_ids;
  const Vec4* built;
  SkinLaw law;
  NeighborLists lists;
  ListControl* control;

  static constexpr int lanes = 32;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    const QueuedSphere queued = queue[i / lanes];
    const std::uint32_t slot = queued.slot;
    const Skinned self = skinned(built[slot], position_radius[slot].w);
    const Skinned before = skinned(queued.start, self.radius);
    auto add_pair = [&](std::uint32_t other) {
      const Vec4 start = built[other];
      const Skinned there = skinned(start, position_radius[other].w);
      if (other == slot || !are_listed(self, there, period, law.reach)) return;
      if (!is_fixed(mass_ids[slot].mass)) add(slot, other);
      if (is_fixed(mass_ids[other].mass)) return;
      // One that is queued too adds this one itself. One that was near before has it in its list already; one that was
      // not may still have it from an earlier time.
      const bool is_queued = start.w < 0.0f;
      if (!is_queued && !are_listed(before, there, period, law.reach) && !has_entry(other, slot)) add(other, slot);
    };
    auto look_at = [&](const Runs& runs) {
      // The others stand in their skins, up to one skin from where their lists begin.
      visit_near(position_radius, period, self.position, self.radius + self.skin + law.reach + 2.0f * law.thickest,
                 runs.total(), runs, add_pair);
    };
    // Others may stand one cell away from that of the last sort.
    const float edge =
        larger(larger(1.0f / shape.x.inverse_edge, 1.0f / shape.y.inverse_edge), 1.0f / shape.z.inverse_edge);
    visit_runs(shape, cell_start, cell_start + 1, self.position, law.search_range(self.radius, self.skin) + edge,
               {static_cast<int>(i % lanes), lanes}, look_at);
  }

  FC_HOST_DEVICE bool has_entry(std::uint32_t owner, std::uint32_t entry) const {
    for (std::uint32_t lane = 0; lane < lists.lanes; ++lane) {
      const std::int64_t row = std::int64_t(owner) * lists.lanes + lane;
      const std::uint32_t* list = lists.of_row(row);
      // Only what was there before: the place of an entry that is just being added may still hold an old one.
      const std::uint32_t count = lists.counts[row].published;
      for (std::uint32_t k = 0; k < count; ++k) {
        if (list[std::int64_t(k) * lists.width] == entry) return true;
      }
    }
    return false;
  }
  FC_HOST_DEVICE void add(std::uint32_t owner, std::uint32_t entry) const {
    const std::int64_t row = std::int64_t(owner) * lists.lanes + entry % lists.lanes;
    const std::uint32_t place = atomic_add(&lists.counts[row].pending, 1);
    if (place < lists.capacity) {
      lists.of_row(row)[std::int64_t(place) * lists.width] = entry;
    } else {
      atomic_max(&control->longest, place + 1);
    }
  }
};

}  // namespace fastcollide
