// Levels and cells for a set of spheres, chosen on the host from what the survey found. Only the time depends on it.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "survey.hpp"

namespace fastcollide::search {

// Edges of a cell in units of the largest reach of two spheres of its level. Wide rows suit wide vector units.
struct CellEdges {
  double along_row, across_rows;
};

// What is to be put into levels, and what will look for it.
struct Population {
  std::int64_t count;
  std::array<std::int64_t, octaves> octave_counts;
  double largest_size;
  double low[3], high[3];
  // Of another set that searches this one; 0 where the set searches itself.
  std::int64_t searcher_count;
  double searcher_size;
};

// The first octave of each level, for the least expected time. Each sphere looks at its own level and the coarser ones;
// a level costs it some runs of slots, and more candidates the more its cells exceed the spheres in them.
inline std::array<int, octaves> first_octaves(const Population& set, const CellEdges& edges, int& level_count) {
  constexpr double run_cost = 8, candidate_cost = 0.5;  // [ns] on a CPU; the time hardly depends on their ratio
  double volume = 1;
  for (int axis = 0; axis < 3; ++axis) volume *= std::max(set.high[axis] - set.low[axis], 2 * set.largest_size);
  std::array<double, octaves + 1> before{};  // spheres in all octaves before
  for (int octave = 0; octave < octaves; ++octave) {
    before[octave + 1] = before[octave] + static_cast<double>(set.octave_counts[octave]);
  }
  const double total = before[octaves];
  const auto size_at = [&](int octave) { return std::ldexp(set.largest_size, -octave); };

  const auto look_cost = [&](double largest, double searcher, double members) {
    const double reach = largest + (set.searcher_count > 0 ? set.searcher_size : largest);
    const double window = 2 * (largest + searcher);
    const double across = edges.across_rows * reach, along = edges.along_row * reach;
    const double rows = (1 + window / across) * (1 + window / across);
    const double swept = (window + along) * (window + across) * (window + across);
    return run_cost * rows + candidate_cost * std::min(members, members * swept / volume);
  };
  const auto level_cost = [&](int begin, int end) {
    const double members = before[end] - before[begin], finer = total - before[end];
    const double size = size_at(begin);
    if (members == 0) return 0.0;
    if (set.searcher_count > 0) {
      return static_cast<double>(set.searcher_count) * look_cost(size, set.searcher_size, members);
    }
    return 0.5 * members * look_cost(size, 0.75 * size, members) + finer * look_cost(size, 0.25 * size, members);
  };

  std::array<double, octaves + 1> best{};  // of the octaves from here on
  std::array<int, octaves + 1> end_of{};
  for (int begin = octaves - 1; begin >= 0; --begin) {
    best[begin] = 1e300;
    for (int end = begin + 1; end <= octaves; ++end) {
      const double cost = level_cost(begin, end) + best[end];
      if (cost < best[begin]) {
        best[begin] = cost;
        end_of[begin] = end;
      }
    }
  }
  std::array<int, octaves> firsts{};
  level_count = 0;
  for (int begin = 0; begin < octaves; begin = end_of[begin]) {
    if (before[end_of[begin]] > before[begin] || level_count == 0) firsts[level_count++] = begin;
  }
  return firsts;
}

template <class T>
Level<T> choose_level(const Population& set, double size, std::int64_t members, const CellEdges& edges) {
  const double reach = size + (set.searcher_count > 0 ? set.searcher_size : size);
  // All levels together stay below 2^32.
  const double budget = std::clamp(2.0 * static_cast<double>(members), 512.0, 2.5e8);
  const double edge[3] = {edges.along_row * reach, edges.across_rows * reach, edges.across_rows * reach};
  double cells[3];
  bool goes_round[3] = {};
  for (int axis = 0; axis < 3; ++axis) {
    cells[axis] = std::min(std::floor((set.high[axis] - set.low[axis]) / edge[axis]) + 1, 1e9);
  }
  // A number of cells that float32 holds exactly.
  constexpr double most_along_axis = 0x1p23;
  for (;;) {
    const int longest = cells[0] >= cells[1] && cells[0] >= cells[2] ? 0 : cells[1] >= cells[2] ? 1 : 2;
    if (cells[0] * cells[1] * cells[2] <= budget && cells[longest] <= most_along_axis) break;
    cells[longest] = std::ceil(0.5 * cells[longest]);
    goes_round[longest] = true;
  }
  const auto axis_of = [&](int axis) {
    return CellAxis<T>{static_cast<T>(set.low[axis]), static_cast<T>(1 / edge[axis]), static_cast<int>(cells[axis]),
                       goes_round[axis]};
  };
  return {axis_of(0), axis_of(1), axis_of(2), static_cast<T>(size * (1 + 4 * static_cast<double>(spacing<T>))), 0};
}

template <class T>
SearchGrid<T> choose_grid(const Population& set, double half_margin, const Bounds<T>& bounds, const Period& period,
                          const CellEdges& edges) {
  SearchGrid<T> grid{};
  grid.base_exponent = exponent_of(set.largest_size);
  grid.half_margin = half_margin;
  grid.bounds = bounds;
  grid.period = period;
  const std::array<int, octaves> firsts = first_octaves(set, edges, grid.level_count);
  for (int k = 0; k < grid.level_count; ++k) {
    const int begin = firsts[k], end = k + 1 < grid.level_count ? firsts[k + 1] : octaves;
    std::int64_t members = 0;
    for (int octave = begin; octave < end; ++octave) {
      members += set.octave_counts[octave];
      grid.level_of_octave[octave] = k;
    }
    // Octaves end at powers of two; the first one has the largest sphere.
    const double size = begin == 0 ? set.largest_size : std::ldexp(1.0, grid.base_exponent - begin + 1);
    Level<T>& level = grid.levels[k] = choose_level<T>(set, size, members, edges);
    level.first_cell = grid.cell_count;
    grid.cell_count += static_cast<std::uint32_t>(level.x.cells) * static_cast<std::uint32_t>(level.y.cells) *
                       static_cast<std::uint32_t>(level.z.cells);
  }
  return grid;
}

}  // namespace fastcollide::search
