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

// The cells with the numbers first ... last.
template <class T>
FC_HOST_DEVICE inline CellIntervals stored_cells(int first, int last, const CellAxis<T>& axis) {
  if (!axis.goes_round) return {{stored_cell(first, axis), 0}, {stored_cell(last, axis) + 1, 0}, 1};
  if (last - first >= axis.cells - 1) return {{0, 0}, {axis.cells, 0}, 1};
  const int begin = stored_cell(first, axis), end = begin + (last - first) + 1;
  if (end <= axis.cells) return {{begin, 0}, {end, 0}, 1};
  return {{begin, 0}, {axis.cells, end - axis.cells}, 2};
}

// The cells around a place, by number.
struct Window {
  int first, last;
};

template <class T>
FC_HOST_DEVICE inline int level_of(T radius, const SearchGrid<T>& grid) {
  return grid.level_count == 1
             ? 0
             : grid.level_of_octave[octave_of(static_cast<double>(radius) + grid.half_margin, grid.base_exponent)];
}

// stored_cell(cell_number(x)) for an axis that does not go round, with less work: cut first, what is left is no less
// than 0, and to cut towards 0 is to round down.
template <class T>
FC_HOST_DEVICE inline int clamped_cell(T x, const CellAxis<T>& axis) {
  const T cell = (x - axis.origin) * axis.inverse_edge, last = static_cast<T>(axis.cells - 1);
  const T cut = cell > T(0) ? cell : T(0);
  return static_cast<int>(cut < last ? cut : last);
}
template <class T>
FC_HOST_DEVICE inline int cell_at(T x, const CellAxis<T>& axis) {
  return axis.goes_round ? stored_cell(cell_number(x, axis), axis) : clamped_cell(x, axis);
}

template <class T>
FC_HOST_DEVICE inline int row_of(Point<T> p, const Level<T>& level) {
  return cell_at(p.y, level.y) + level.y.cells * cell_at(p.z, level.z);
}
template <class T>
FC_HOST_DEVICE inline std::uint32_t cell_of(Point<T> p, const Level<T>& level) {
  return level.first_cell + static_cast<std::uint32_t>(cell_at(p.x, level.x)) +
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

template <class T>
FC_HOST_DEVICE inline Window window_around(T x, T reach, const CellAxis<T>& axis) {
  const T pad = padded(x, reach);
  return {cell_number(x - pad, axis), cell_number(x + pad, axis)};
}

// How far from a sphere others of a level may be that touch it.
template <class T>
FC_HOST_DEVICE inline T reach_into(const Level<T>& level, T radius, T half_margin) {
  return (radius + half_margin) * (T(1) + T(4) * spacing<T>)+level.largest_size;
}

// Calls visit(begin, end) for each run of slots of a level in the cells of three windows, rows below `from_row` left
// out.
template <class T, class Visit>
FC_HOST_DEVICE inline void visit_runs(const Level<T>& level, const std::uint32_t* cell_start, Window along_x,
                                      Window along_y, Window along_z, int from_row, Visit& visit) {
  const CellIntervals xs = stored_cells(along_x.first, along_x.last, level.x);
  const CellIntervals ys = stored_cells(along_y.first, along_y.last, level.y);
  const CellIntervals zs = stored_cells(along_z.first, along_z.last, level.z);
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

// Calls visit(begin, end, image) for each run of slots of a level around the images of a place, itself included or not.
// Rows below `from_row`, which hold only smaller slots than the place's own, are left out.
template <class T, class Visit>
FC_HOST_DEVICE inline void visit_images(const SearchGrid<T>& grid, int k, const std::uint32_t* cell_start, Point<T> p,
                                        T reach, int from_row, bool with_itself, Visit& visit) {
  const Level<T>& level = grid.levels[k];
  const ImageSteps xs = image_steps(p.x, reach, grid, 0);
  const ImageSteps ys = image_steps(p.y, reach, grid, 1);
  const ImageSteps zs = image_steps(p.z, reach, grid, 2);
  for (int z = zs.first; z <= zs.last; ++z) {
    for (int y = ys.first; y <= ys.last; ++y) {
      for (int x = xs.first; x <= xs.last; ++x) {
        const int image = (x + 1) + 3 * (y + 1) + 9 * (z + 1);
        if (image == no_image && !with_itself) continue;
        const Point<double> shift = grid.period.shift(image);
        auto visit_run = [&](std::uint32_t begin, std::uint32_t end) { visit(begin, end, image); };
        visit_runs(level, cell_start, window_around(static_cast<T>(p.x + shift.x), reach, level.x),
                   window_around(static_cast<T>(p.y + shift.y), reach, level.y),
                   window_around(static_cast<T>(p.z + shift.z), reach, level.z), from_row, visit_run);
      }
    }
  }
}

}  // namespace fastcollide::search
