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

// How far cell i of those within reach of x is from x at least [m].
FC_HOST_DEVICE inline float distance_of_cell(const CellRange& range, int i, float x, float reach,
                                             const GridAxis& axis) {
  const float edge = 1.0f / axis.inverse_edge;
  // What cells_within() makes up for, and as much again for the roundings here.
  const float rounding = 2e-6f * (fabsf(x - axis.origin) + reach + static_cast<float>(axis.cells) * edge);
  const bool has_ends = axis.boundary == Boundary::wall;
  if (!has_ends && range.count == axis.cells) return 0.0f;
  // Where the axis goes round, cells are counted from the origin as if it did not.
  const float first =
      has_ends ? static_cast<float>(range.first) : floorf((x - (reach + rounding) - axis.origin) * axis.inverse_edge);
  const float low = axis.origin + (first + static_cast<float>(i)) * edge, high = low + edge;
  // The cells at the ends hold all that lies beyond.
  const float below = has_ends && range.first + i == 0 ? 0.0f : low - x;
  const float above = has_ends && range.first + i == axis.cells - 1 ? 0.0f : x - high;
  return larger(larger(below, above) - 2.0f * rounding, 0.0f);
}

}  // namespace fastcollide
