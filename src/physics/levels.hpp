// Uniform grids in levels: spheres of about the same size share a grid whose cells suit them, so that small ones do not
// look through cells as large as the largest. A sphere looks at all levels.
#pragma once

#include "cell.hpp"

namespace fastcollide {

// Of sizes below the largest; the last takes all that is smaller. A level has one of them or several.
inline constexpr int octaves = 16;
inline constexpr int most_levels = octaves;

struct CellLevel {
  GridShape shape;
  float largest_radius;
  std::uint32_t first_cell;  // the cells of a level come after those of the coarser ones
};

// Level 0 has the largest spheres.
struct CellLevels {
  CellLevel levels[most_levels];
  std::uint8_t level_of_octave[octaves];
  int count;
  int largest_exponent;  // of the radii
  float margin;          // between two surfaces, that a pass looks at [m]
  std::uint32_t cells;   // of all levels
};

FC_HOST_DEVICE inline int exponent_of(float radius) { return static_cast<int>((bits_of(radius) >> 23) & 0xFFu); }

FC_HOST_DEVICE inline int octave_of(float radius, int largest_exponent) {
  const int octave = largest_exponent - exponent_of(radius);
  return octave < 0 ? 0 : octave < octaves ? octave : octaves - 1;
}

FC_HOST_DEVICE inline int level_of(float radius, const CellLevels& levels) {
  return levels.level_of_octave[octave_of(radius, levels.largest_exponent)];
}

FC_HOST_DEVICE inline std::uint32_t cell_of_sphere(Vec3 position, float radius, const CellLevels& levels) {
  if (levels.count == 1) return cell_hash(cell_of(position, levels.levels[0].shape), levels.levels[0].shape);
  const CellLevel& level = levels.levels[level_of(radius, levels)];
  return level.first_cell + cell_hash(cell_of(position, level.shape), level.shape);
}

// How far apart two surfaces may be that a contact pass looks at. Much of a small sphere is no margin of a large one.
FC_HOST_DEVICE inline float margin_of_pair(float radius, float other_radius, float margin) {
  return smaller(margin, 0.5f * smaller(radius, other_radius));
}

// The cells of an axis that may hold what is within `reach` of x, and how far each is from x at least.
struct CellsAround {
  CellRange range;
  float x, origin, edge, slack;
  float first;    // cells from the origin to the first one, where the axis goes round before it does
  bool is_whole;  // the axis goes round and all of it is within reach
  bool has_ends;  // the first and the last cell hold all that lies beyond
  int last;

  FC_HOST_DEVICE CellsAround(float x_, float reach, const GridAxis& axis)
      : range(cells_within(x_, reach, axis)), x(x_), origin(axis.origin), edge(1.0f / axis.inverse_edge) {
    const float extent = static_cast<float>(axis.cells) * edge;
    // Of cells_within(), and as much again for the roundings here.
    const float rounding = 2e-6f * (fabsf(x - origin) + reach + extent);
    has_ends = axis.boundary == Boundary::wall;
    is_whole = !has_ends && range.count == axis.cells;
    last = axis.cells - 1;
    slack = 2.0f * rounding;
    first = has_ends ? static_cast<float>(range.first) : floorf((x - (reach + rounding) - origin) * axis.inverse_edge);
  }
  FC_HOST_DEVICE float distance(int i) const {
    if (is_whole) return 0.0f;
    const float low = origin + (first + static_cast<float>(i)) * edge, high = low + edge;
    const bool is_below = has_ends && range.first + i == 0, is_above = has_ends && range.first + i == last;
    return larger(larger(is_below ? 0.0f : low - x, is_above ? 0.0f : x - high) - slack, 0.0f);
  }
};

}  // namespace fastcollide
