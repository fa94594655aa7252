// Where a contact pass finds the spheres near one, and where it writes what became of it.
#pragma once

#include "../backend/lane.hpp"
#include "../data.hpp"

namespace fastcollide {

// Calls visit(other) for each other slot in the 27 cells around the position.
template <class Visit>
FC_HOST_DEVICE inline void visit_neighbor_cells(const GridView& grid, std::int64_t slot, Vec3 position, Visit& visit) {
  const GridShape& shape = grid.shape;
  const Vec3i center = cell_of(position, shape);
  const CellRange xs = adjacent_cells(center.x, shape.x);
  const CellRange ys = adjacent_cells(center.y, shape.y);
  const CellRange zs = adjacent_cells(center.z, shape.z);
  for (int k = 0; k < zs.count; ++k) {
    for (int j = 0; j < ys.count; ++j) {
      for (int i = 0; i < xs.count; ++i) {
        const std::uint32_t cell = cell_hash(
            {cell_in_range(xs, i, shape.x), cell_in_range(ys, j, shape.y), cell_in_range(zs, k, shape.z)}, shape);
        const std::uint32_t end = grid.cell_end[cell];
        for (std::uint32_t other = grid.cell_start[cell]; other < end; ++other) {
          if (other != slot) visit(other);
        }
      }
    }
  }
}

// How a contact pass is run: as two steps, so that lanes can add up what they gathered in between.
template <class Pass>
FC_HOST_DEVICE inline void run_alone(const Pass& pass, std::int64_t slot) {
  pass.finish(slot, pass.gather(slot, Lane{}));
}

struct CellNeighbors {
  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane, Visit& visit) const {
    visit_neighbor_cells(grid, slot, position, visit);
  }
};

// Writes to the bodies, in the order of the ids.
struct ToBodies {
  Vec3* positions;
  Vec3* velocities;
  Vec3* spins;      // or null: they do not change
  float* crowding;  // or null: of the default solver

  FC_HOST_DEVICE void write(std::int64_t, const Sphere& sphere, Vec3 position, Vec3 velocity, Vec3 spin) const {
    positions[sphere.id] = position;
    velocities[sphere.id] = velocity;
    if (spins != nullptr) spins[sphere.id] = spin;
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t, const Sphere& sphere, float value) const {
    crowding[sphere.id] = value;
  }
};

FC_HOST_DEVICE inline Vec3 spin_in_slot(const GridView& grid, std::int64_t slot) {
  return grid.spins == nullptr ? Vec3{0, 0, 0} : grid.spins[slot];
}

}  // namespace fastcollide
