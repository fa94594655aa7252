// The uniform grid of cells that covers the box.
#pragma once

#include "box.hpp"

namespace fastcollide {

// One axis of the grid. Along a periodic axis the cells go round; along an open one, too: far cells share a number,
// which costs a few candidates and needs no grid of the whole range.
struct GridAxis {
  float origin;        // lower end, 0 for an open axis [m]
  float inverse_edge;  // 1 / edge [1/m]
  int cells;
  Boundary boundary;
};

struct GridShape {
  GridAxis x, y, z;
};

FC_HOST_DEVICE inline int cell_coordinate(float position, const GridAxis& axis) {
  // Floor, not truncation: both sides of the origin get cells of the same size.
  const float cell = floorf((position - axis.origin) * axis.inverse_edge);
  if (axis.boundary == Boundary::open) {
    const int wrapped = static_cast<int>(clamp(cell, -1e9f, 1e9f)) % axis.cells;
    return wrapped < 0 ? wrapped + axis.cells : wrapped;
  }
  // The cut comes before the conversion, which is only defined in the range of int.
  return static_cast<int>(clamp(cell, 0.0f, static_cast<float>(axis.cells - 1)));
}

FC_HOST_DEVICE inline Vec3i cell_of(Vec3 position, const GridShape& grid) {
  return {cell_coordinate(position.x, grid.x), cell_coordinate(position.y, grid.y),
          cell_coordinate(position.z, grid.z)};
}

// The cells next to one along an axis, and itself: first, first + 1, ..., each once also where the axis has less than
// three.
struct CellRange {
  int first, count;
};

FC_HOST_DEVICE inline CellRange adjacent_cells(int cell, const GridAxis& axis) {
  if (axis.boundary == Boundary::wall) {
    const int first = cell > 0 ? cell - 1 : 0, last = cell + 1 < axis.cells ? cell + 1 : axis.cells - 1;
    return {first, last - first + 1};
  }
  return axis.cells < 3 ? CellRange{0, axis.cells} : CellRange{cell == 0 ? axis.cells - 1 : cell - 1, 3};
}

// The cells of all coordinates from x - reach to x + reach, each once. Floor and its argument never decrease with x, so
// only the rounding of the two ends has to be made up for.
FC_HOST_DEVICE inline CellRange cells_within(float x, float reach, const GridAxis& axis) {
  const float extent = static_cast<float>(axis.cells) / axis.inverse_edge;
  const float wide = reach + 2e-6f * (fabsf(x - axis.origin) + reach + extent);
  const float first = floorf((x - wide - axis.origin) * axis.inverse_edge);
  const float last = floorf((x + wide - axis.origin) * axis.inverse_edge);
  if (axis.boundary == Boundary::wall) {
    const float end = static_cast<float>(axis.cells - 1);
    const int from = static_cast<int>(clamp(first, 0.0f, end)), to = static_cast<int>(clamp(last, 0.0f, end));
    return {from, to - from + 1};
  }
  if (!(last - first + 1.0f < static_cast<float>(axis.cells))) return {0, axis.cells};
  const int wrapped = static_cast<int>(clamp(first, -1e9f, 1e9f)) % axis.cells;
  return {wrapped < 0 ? wrapped + axis.cells : wrapped, static_cast<int>(last - first) + 1};
}

// How far from a coordinate those cells are, from the side that faces it.
struct CellDistances {
  float place;  // of the coordinate, in cells from the first one
  float edge;   // of a cell, 0 where nothing is known [m]

  FC_HOST_DEVICE CellDistances(float x, const CellRange& range, const GridAxis& axis) {
    const float cells = static_cast<float>(axis.cells);
    float along = (x - axis.origin) * axis.inverse_edge;
    edge = 1.0f / axis.inverse_edge;
    const bool is_far = !(fabsf(along) < 2e4f);  // where rounding is more than the hundredth of a cell below
    if (axis.boundary == Boundary::wall) {
      if (is_far) edge = 0.0f;
      along = clamp(along, 0.0f, cells);  // the cells at the ends hold what lies beyond
      place = along - static_cast<float>(range.first);
    } else {
      if (is_far || range.count >= axis.cells) edge = 0.0f;
      place = along - static_cast<float>(range.first);
      place -= cells * floorf((place + 0.5f) / cells);  // the first cell may have gone round
    }
  }
  // Squared, and a little less than it is; of the cell that is `i` after the first one [m²].
  FC_HOST_DEVICE float squared(int i) const {
    const float before = static_cast<float>(i) - place, behind = place - static_cast<float>(i + 1);
    const float distance = larger(larger(before, behind) - 0.01f, 0.0f) * edge;
    return distance * distance;
  }
};

FC_HOST_DEVICE inline int cell_in_range(const CellRange& range, int i, const GridAxis& axis) {
  const int cell = range.first + i;
  return cell < axis.cells ? cell : cell - axis.cells;
}

FC_HOST_DEVICE inline std::uint32_t cell_hash(Vec3i cell, const GridShape& grid) {
  return static_cast<std::uint32_t>(cell.x + grid.x.cells * (cell.y + grid.y.cells * cell.z));
}

}  // namespace fastcollide
