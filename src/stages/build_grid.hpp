// Hash each sphere to its cell, sort, find where each cell starts and ends, copy the state into that order.
#pragma once

#include <bit>

#include "../data.hpp"

namespace fastcollide {

struct HashCells {
  GridShape shape;
  const Vec3* positions;
  std::uint32_t* cells;
  std::uint32_t* ids;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    cells[i] = cell_hash(cell_of(positions[i], shape), shape);
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
  const float* body_frictions;  // or null
  std::uint32_t* cell_start;
  std::uint32_t* cell_end;
  Vec4* position_radius;
  Vec4* velocity_restitution;
  float* masses;
  float* crowding;
  Vec3* spins;
  float* frictions;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t cell = cells[slot];
    if (slot == 0 || cells[slot - 1] != cell) cell_start[cell] = static_cast<std::uint32_t>(slot);
    if (slot == count - 1 || cells[slot + 1] != cell) cell_end[cell] = static_cast<std::uint32_t>(slot + 1);
    const std::uint32_t id = ids[slot];
    const Vec3 position = positions[id], velocity = velocities[id];
    position_radius[slot] = {position.x, position.y, position.z, radii[id]};
    velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, restitutions[id]};
    masses[slot] = body_masses[id];
    if (body_crowding != nullptr) crowding[slot] = body_crowding[id];
    if (body_spins != nullptr) spins[slot] = body_spins[id];
    if (body_frictions != nullptr) frictions[slot] = body_frictions[id];
  }
};

// crowding: of each sphere, for stages that read it from the grid, or null.
template <Backend B>
void build_grid(B& backend, const Bodies<B>& bodies, const float* crowding, Grid<B>& grid) {
  const std::int64_t count = bodies.count();
  const GridShape& shape = grid.shape;
  const std::int64_t cells = std::int64_t(shape.x.cells) * shape.y.cells * shape.z.cells;
  for (auto* buffer : {&grid.unsorted_cells, &grid.unsorted_ids, &grid.cells, &grid.ids}) buffer->resize(count);
  for (auto* buffer : {&grid.cell_start, &grid.cell_end}) buffer->resize(cells);
  for (auto* buffer : {&grid.position_radius, &grid.velocity_restitution}) buffer->resize(count);
  grid.masses.resize(count);
  grid.crowding.resize(crowding == nullptr ? 0 : count);
  grid.spins.resize(bodies.is_rough ? count : 0);
  grid.frictions.resize(bodies.is_rough ? count : 0);

  backend.for_each(count,
                   HashCells{shape, bodies.positions.data(), grid.unsorted_cells.data(), grid.unsorted_ids.data()});
  backend.sort_pairs(static_cast<const std::uint32_t*>(grid.unsorted_cells.data()), grid.cells.data(),
                     static_cast<const std::uint32_t*>(grid.unsorted_ids.data()), grid.ids.data(), count,
                     std::bit_width(static_cast<std::uint64_t>(cells - 1)));
  // An empty cell keeps start = end = 0.
  backend.fill_zero(grid.cell_start.data(), cells);
  backend.fill_zero(grid.cell_end.data(), cells);
  backend.for_each(
      count, FillSlots{count, grid.cells.data(), grid.ids.data(), bodies.positions.data(), bodies.velocities.data(),
                       bodies.radii.data(), bodies.masses.data(), bodies.restitutions.data(), crowding,
                       bodies.spins.data(), bodies.frictions.data(), grid.cell_start.data(), grid.cell_end.data(),
                       grid.position_radius.data(), grid.velocity_restitution.data(), grid.masses.data(),
                       grid.crowding.data(), grid.spins.data(), grid.frictions.data()});
}

}  // namespace fastcollide
