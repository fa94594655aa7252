// The uniform grid of cells that covers the box.
#pragma once

#include "../math.hpp"

namespace fastcollide {

struct Box {
  Vec3 lower, upper;  // [m]
};

struct GridShape {
  Vec3 origin;         // lower corner [m]
  float inverse_edge;  // 1 / edge [1/m]
  Vec3i cells;         // number of cells along each axis
};

FC_HOST_DEVICE inline int cell_coordinate(float x, float origin, float inverse_edge, int cells) {
  // Floor, not truncation: both sides of the origin get cells of the same size. The cut comes before the conversion,
  // which is only defined in the range of int.
  const float cell = floorf((x - origin) * inverse_edge);
  return static_cast<int>(clamp(cell, 0.0f, static_cast<float>(cells - 1)));
}

FC_HOST_DEVICE inline Vec3i cell_of(Vec3 position, const GridShape& grid) {
  return {cell_coordinate(position.x, grid.origin.x, grid.inverse_edge, grid.cells.x),
          cell_coordinate(position.y, grid.origin.y, grid.inverse_edge, grid.cells.y),
          cell_coordinate(position.z, grid.origin.z, grid.inverse_edge, grid.cells.z)};
}

FC_HOST_DEVICE inline std::uint32_t cell_hash(Vec3i cell, const GridShape& grid) {
  return static_cast<std::uint32_t>(cell.x + grid.cells.x * (cell.y + grid.cells.y * cell.z));
}

}  // namespace fastcollide
