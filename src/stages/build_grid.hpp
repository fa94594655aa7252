// Hash each sphere to its cell, sort, find where each cell starts and ends, copy the state into that order.
#pragma once

#include <bit>

#include "../data.hpp"

namespace fastcollide {

struct HashCells {
  CellLevels levels;
  const Vec3* positions;
  const float* radii;
  std::uint32_t* cells;
  std::uint32_t* ids;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    cells[i] = cell_of_sphere(positions[i], radii[i], levels);
    ids[i] = static_cast<std::uint32_t>(i);
  }
};

struct FillSlots {
  std::int64_t count;
  const std::uint32_t* cells;
  const std::uint32_t* ids;
  const Vec3* positions;
  const Vec3* velocities;
  const float* radii;
  const float* body_masses;
  const float* restitutions;
  const float* body_crowding;   // or null
  const Vec3* body_spins;       // or null
  const float* body_frictions;  // likewise
  std::uint32_t* cell_start;    // or null: found already
  std::uint32_t* cell_end;
  Vec4* position_radius;
  Vec4* velocity_restitution;
  MassId* mass_ids;
  float* crowding;
  Spin* spins;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t cell = cells[slot];
    if (cell_start != nullptr) {
      if (slot == 0 || cells[slot - 1] != cell) cell_start[cell] = static_cast<std::uint32_t>(slot);
      if (slot == count - 1 || cells[slot + 1] != cell) cell_end[cell] = static_cast<std::uint32_t>(slot + 1);
    }
    const std::uint32_t id = ids[slot];
    const Vec3 position = positions[id], velocity = velocities[id];
    position_radius[slot] = {position.x, position.y, position.z, radii[id]};
    velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, restitutions[id]};
    mass_ids[slot] = {body_masses[id], id};
    if (body_crowding != nullptr) crowding[slot] = body_crowding[id];
    if (body_spins != nullptr) spins[slot] = {body_spins[id], body_frictions[id]};
  }
};

struct CountSlots {
  const std::uint32_t* cells;
  std::uint32_t* counts;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const { atomic_add(counts + cells[slot], 1); }
};

// crowding: of each sphere, for stages that read it from the grid, or null.
template <Backend B>
void build_grid(B& backend, const Bodies<B>& bodies, const float* crowding, Grid<B>& grid) {
  const std::int64_t count = bodies.count();
  const std::int64_t cells = grid.levels.cells;
  const bool has_levels = grid.levels.count > 1;
  for (auto* buffer : {&grid.unsorted_cells, &grid.unsorted_ids, &grid.cells, &grid.ids}) buffer->resize(count);
  for (auto* buffer : {&grid.cell_start, &grid.cell_end}) buffer->resize(cells + 1);
  for (auto* buffer : {&grid.position_radius, &grid.velocity_restitution}) buffer->resize(count);
  grid.mass_ids.resize(count);
  grid.crowding.resize(crowding == nullptr ? 0 : count);
  grid.spins.resize(bodies.is_rough ? count : 0);

  backend.for_each(count, HashCells{grid.levels, bodies.positions.data(), bodies.radii.data(),
                                    grid.unsorted_cells.data(), grid.unsorted_ids.data()});
  backend.sort_pairs(static_cast<const std::uint32_t*>(grid.unsorted_cells.data()), grid.cells.data(),
                     static_cast<const std::uint32_t*>(grid.unsorted_ids.data()), grid.ids.data(), count,
                     std::bit_width(static_cast<std::uint64_t>(cells - 1)));
  backend.fill_zero(grid.cell_start.data(), cells);
  if (has_levels) {
    // A search there looks at runs of cells, which may be empty.
    backend.for_each(count, CountSlots{grid.cells.data(), grid.cell_start.data()});
    backend.exclusive_scan(grid.cell_start.data(), cells);
  } else {
    backend.fill_zero(grid.cell_end.data(), cells);  // an empty cell keeps start = end = 0
  }
  backend.for_each(
      count, FillSlots{count, grid.cells.data(), grid.ids.data(), bodies.positions.data(), bodies.velocities.data(),
                       bodies.radii.data(), bodies.masses.data(), bodies.restitutions.data(), crowding,
                       bodies.spins.data(), bodies.frictions.data(), has_levels ? nullptr : grid.cell_start.data(),
                       grid.cell_end.data(), grid.position_radius.data(), grid.velocity_restitution.data(),
                       grid.mass_ids.data(), grid.crowding.data(), grid.spins.data()});
}

}  // namespace fastcollide
