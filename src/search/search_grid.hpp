// Uniform grids in levels: spheres of about the same size share a grid whose cells suit them. A sphere searches its own
// level and the coarser ones, so that every pair is found from its smaller side.
//
// Nothing is missed because cell_number() never decreases along an axis, rounding included: whatever lies between two
// places lies in a cell between theirs. So any edge of the cells gives the same pairs.
#pragma once

#include "reach.hpp"

namespace fastcollide::search {

template <class T>
struct CellAxis {
  T origin, inverse_edge;
  int cells;
  bool goes_round;  // the range has more cells than the axis: far ones share a number, which costs a few candidates
};

template <class T>
struct Level {
  CellAxis<T> x, y, z;
  T largest_size;            // of its spheres: radius + margin / 2, rounded up
  std::uint32_t first_cell;  // of all levels one after the other
};

inline constexpr int octaves = 16;  // of sizes below the largest; the last takes all that is smaller
inline constexpr int most_levels = octaves;

// Level 0 has the largest spheres; a level and its cells come after the coarser ones. Cell c holds the slots
// cell_start[c] ... cell_start[c + 1] - 1; x runs fastest, so neighbouring cells of a row are one run of slots.
template <class T>
struct SearchGrid {
  Level<T> levels[most_levels];
  int level_count;
  int base_exponent;  // of the sizes at level 0
  int level_of_octave[octaves];
  std::uint32_t cell_count;
  double half_margin;
  Bounds<T> bounds;
  Period period;
};

FC_HOST_DEVICE inline int exponent_of(double x) {  // of a normal number; 0 has the smallest
  std::uint64_t bits;
  memcpy(&bits, &x, sizeof bits);
  return static_cast<int>((bits >> 52) & 0x7FF) - 1023;
}
FC_HOST_DEVICE inline int octave_of(double size, int base_exponent) {
  const int octave = base_exponent - exponent_of(size);
  return octave < 0 ? 0 : octave < octaves ? octave : octaves - 1;
}

template <class T>
FC_HOST_DEVICE inline int cell_number(T x, const CellAxis<T>& axis) {
  const T cell = (x - axis.origin) * axis.inverse_edge;
  const T cut = cell < T(1e9) ? (cell > T(-1e9) ? cell : T(-1e9)) : T(1e9);
  const int toward_zero = static_cast<int>(cut);
  return toward_zero - (static_cast<T>(toward_zero) > cut ? 1 : 0);
}

// A range of cells of an axis as one or two intervals of stored cells [begin, end).
struct CellIntervals {
  int begin[2], end[2];
  int count;
};

template <class T>
FC_HOST_DEVICE inline int stored_cell(int number, const CellAxis<T>& axis) {
  if (axis.goes_round) {
    const int rest = number % axis.cells;
    return rest < 0 ? rest + axis.cells : rest;
  }
  return number < 0 ? 0 : number < axis.cells ? number : axis.cells - 1;
}

template <class T>
FC_HOST_DEVICE inline CellIntervals cells_between(T low, T high, const CellAxis<T>& axis) {
  const int first = cell_number(low, axis), last = cell_number(high, axis);
  if (!axis.goes_round) return {{stored_cell(first, axis), 0}, {stored_cell(last, axis) + 1, 0}, 1};
  if (last - first >= axis.cells - 1) return {{0, 0}, {axis.cells, 0}, 1};
  const int begin = stored_cell(first, axis), end = begin + (last - first) + 1;
  if (end <= axis.cells) return {{begin, 0}, {end, 0}, 1};
  return {{begin, 0}, {axis.cells, end - axis.cells}, 2};
}

template <class T>
FC_HOST_DEVICE inline int level_of(T radius, const SearchGrid<T>& grid) {
  return grid.level_count == 1
             ? 0
             : grid.level_of_octave[octave_of(static_cast<double>(radius) + grid.half_margin, grid.base_exponent)];
}

template <class T>
FC_HOST_DEVICE inline int row_of(Point<T> p, const Level<T>& level) {
  return stored_cell(cell_number(p.y, level.y), level.y) +
         level.y.cells * stored_cell(cell_number(p.z, level.z), level.z);
}
template <class T>
FC_HOST_DEVICE inline std::uint32_t cell_of(Point<T> p, const Level<T>& level) {
  return level.first_cell + static_cast<std::uint32_t>(stored_cell(cell_number(p.x, level.x), level.x)) +
         static_cast<std::uint32_t>(level.x.cells) * static_cast<std::uint32_t>(row_of(p, level));
}

// Unit of the last place, at most, of a number: 2^-23 or 2^-52.
template <class T>
inline constexpr T spacing = sizeof(T) == 4 ? T(0x1p-23) : T(0x1p-52);

FC_HOST_DEVICE inline float absolute(float x) { return fabsf(x); }
FC_HOST_DEVICE inline double absolute(double x) { return fabs(x); }

// How far around a place to look, and the rounding of the place and of this sum on top.
template <class T>
FC_HOST_DEVICE inline T padded(T x, T reach) {
  return reach + T(4) * spacing<T> * (absolute(x) + reach);
}

// Calls visit(begin, end) for each run of slots of a level that may hold spheres within `reach` of the place, rows
// below `from_row` left out.
template <class T, class Visit>
FC_HOST_DEVICE inline void visit_runs(const Level<T>& level, const std::uint32_t* cell_start, Point<T> p, T reach,
                                      int from_row, Visit& visit) {
  const T pad_x = padded(p.x, reach), pad_y = padded(p.y, reach), pad_z = padded(p.z, reach);
  const CellIntervals xs = cells_between(p.x - pad_x, p.x + pad_x, level.x);
  const CellIntervals ys = cells_between(p.y - pad_y, p.y + pad_y, level.y);
  const CellIntervals zs = cells_between(p.z - pad_z, p.z + pad_z, level.z);
  for (int c = 0; c < zs.count; ++c) {
    for (int z = zs.begin[c]; z < zs.end[c]; ++z) {
      for (int b = 0; b < ys.count; ++b) {
        for (int y = ys.begin[b]; y < ys.end[b]; ++y) {
          const int row = y + level.y.cells * z;
          if (row < from_row) continue;
          const std::uint32_t* cells = cell_start + level.first_cell +
                                       static_cast<std::uint32_t>(level.x.cells) * static_cast<std::uint32_t>(row);
          for (int a = 0; a < xs.count; ++a) visit(cells[xs.begin[a]], cells[xs.end[a]]);
        }
      }
    }
  }
}

// Which images of a place may be within `reach` of something inside the box: steps of the period along one axis.
struct ImageSteps {
  int first, last;
};
template <class T>
FC_HOST_DEVICE inline ImageSteps image_steps(T x, T reach, const SearchGrid<T>& grid, int axis) {
  if (!grid.bounds.is_periodic[axis]) return {0, 0};
  const T pad =
      padded(x, reach) + T(4) * spacing<T> * (absolute(grid.bounds.lower[axis]) + absolute(grid.bounds.upper[axis]));
  return {x + pad >= grid.bounds.upper[axis] ? -1 : 0, x - pad <= grid.bounds.lower[axis] ? 1 : 0};
}

// Calls visit(begin, end, image) for each run of slots of a level, around the place and each of its images. Rows below
// `from_row` hold only smaller slots than the place's own; they are left out.
template <class T, class Visit>
FC_HOST_DEVICE inline void visit_level(const SearchGrid<T>& grid, int k, const std::uint32_t* cell_start, Point<T> p,
                                       T radius, int from_row, Visit& visit) {
  const Level<T>& level = grid.levels[k];
  const T reach = (radius + static_cast<T>(grid.half_margin)) * (T(1) + T(4) * spacing<T>)+level.largest_size;
  if (!grid.period.is_any()) {
    auto visit_run = [&](std::uint32_t begin, std::uint32_t end) { visit(begin, end, no_image); };
    return visit_runs(level, cell_start, p, reach, from_row, visit_run);
  }
  const ImageSteps xs = image_steps(p.x, reach, grid, 0);
  const ImageSteps ys = image_steps(p.y, reach, grid, 1);
  const ImageSteps zs = image_steps(p.z, reach, grid, 2);
  for (int z = zs.first; z <= zs.last; ++z) {
    for (int y = ys.first; y <= ys.last; ++y) {
      for (int x = xs.first; x <= xs.last; ++x) {
        const int image = (x + 1) + 3 * (y + 1) + 9 * (z + 1);
        const Point<double> shift = grid.period.shift(image);
        auto visit_run = [&](std::uint32_t begin, std::uint32_t end) { visit(begin, end, image); };
        visit_runs(
            level, cell_start,
            Point<T>{static_cast<T>(p.x + shift.x), static_cast<T>(p.y + shift.y), static_cast<T>(p.z + shift.z)},
            reach, from_row, visit_run);
      }
    }
  }
}

}  // namespace fastcollide::search
