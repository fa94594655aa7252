// Where a pass finds the spheres near one in grids of several levels.
#pragma once

#include "../physics/levels.hpp"
#include "neighbor_lists.hpp"

namespace fastcollide {

// Calls visit_run(begin, end) for runs of slots that hold, among others, all spheres of a level whose centres are
// within `reach` of a place; rows of cells are shared among the lanes. Where there are many, each is cut to what the
// ball covers: a large sphere is full of cells of small ones.
template <class VisitRun>
FC_HOST_DEVICE inline void visit_ball(const CellLevel& level, const std::uint32_t* cell_start,
                                      const std::uint32_t* cell_end, Vec3 position, float reach, Lane lane,
                                      const VisitRun& visit_run) {
  constexpr int few_rows = 16;
  const GridShape& shape = level.shape;
  const CellRange ys = cells_within(position.y, reach, shape.y), zs = cells_within(position.z, reach, shape.z);
  const bool are_many = ys.count * zs.count > few_rows;
  CellRange xs = cells_within(position.x, reach, shape.x);
  int y = lane.index, z = 0;
  for (;;) {
    for (; y >= ys.count; y -= ys.count) ++z;
    if (z >= zs.count) return;
    bool is_outside = false;
    if (are_many) {
      const float off_y = distance_of_cell(ys, y, position.y, reach, shape.y);
      const float off_z = distance_of_cell(zs, z, position.z, reach, shape.z);
      const float left = 1.00001f * (reach * reach) - (off_y * off_y + off_z * off_z);  // the rest is rounding
      is_outside = left <= 0.0f;
      xs = cells_within(position.x, square_root(larger(left, 0.0f)), shape.x);
    }
    if (!is_outside) {
      const Vec3i first{0, cell_in_range(ys, y, shape.y), cell_in_range(zs, z, shape.z)};
      const std::uint32_t row = level.first_cell + cell_hash(first, shape);
      const int inside = xs.first + xs.count <= shape.x.cells ? xs.count : shape.x.cells - xs.first;
      const auto visit_cells = [&](int begin, int cells) {
        visit_run(cell_start[row + static_cast<std::uint32_t>(begin)],
                  cell_end[row + static_cast<std::uint32_t>(begin + cells - 1)]);
      };
      visit_cells(xs.first, inside);
      if (inside < xs.count) visit_cells(0, xs.count - inside);
    }
    y += lane.count;
  }
}

struct LevelNeighbors {
  CellLevels levels;
  const std::uint32_t *cell_start, *cell_end;

  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, Visit& visit) const {
    const float radius = grid.position_radius[slot].w;
    for (int k = 0; k < levels.count; ++k) {
      const CellLevel& level = levels.levels[k];
      const float range = radius + margin_of_pair(radius, level.largest_radius, levels.margin);
      auto visit_other = [&](std::int64_t other) {
        if (other != slot) visit(other);
      };
      const auto visit_run = [&](std::uint32_t begin, std::uint32_t end) {
        if (end - begin <= 4) {
          for (std::uint32_t other = begin; other < end; ++other) {
            const Vec4 there = grid.position_radius[other];
            const Vec3 offset = separation(position, {there.x, there.y, there.z}, grid.period);
            const float most = (range + there.w) * 1.00001f;
            if (dot(offset, offset) <= most * most) visit_other(other);
          }
          return;
        }
        const auto slot_at = [begin](std::uint32_t i) { return begin + i; };
        visit_near(grid.position_radius, grid.period, position, range, end - begin, slot_at, visit_other);
      };
      visit_ball(level, cell_start, cell_end, position, range + level.largest_radius, lane, visit_run);
    }
  }
};

// Calls visit(other) for each other slot in the 27 cells around the position.
template <class Visit>
FC_HOST_DEVICE inline void visit_adjacent_cells(const GridShape& shape, const std::uint32_t* cell_start,
                                                const std::uint32_t* cell_end, std::int64_t slot, Vec3 position,
                                                Visit& visit) {
  const Vec3i center = cell_of(position, shape);
  const CellRange xs = adjacent_cells(center.x, shape.x);
  const CellRange ys = adjacent_cells(center.y, shape.y);
  const CellRange zs = adjacent_cells(center.z, shape.z);
  for (int k = 0; k < zs.count; ++k) {
    for (int j = 0; j < ys.count; ++j) {
      for (int i = 0; i < xs.count; ++i) {
        const std::uint32_t cell = cell_hash(
            {cell_in_range(xs, i, shape.x), cell_in_range(ys, j, shape.y), cell_in_range(zs, k, shape.z)}, shape);
        const std::uint32_t end = cell_end[cell];
        for (std::uint32_t other = cell_start[cell]; other < end; ++other) {
          if (other != slot) visit(other);
        }
      }
    }
  }
}

// Of a new grid for every pass: one level, or several where sizes differ much.
struct CellNeighbors {
  LevelNeighbors cells;

  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, Visit& visit) const {
    if (cells.levels.count > 1) return cells.visit(grid, slot, position, lane, visit);
    visit_adjacent_cells(cells.levels.levels[0].shape, cells.cell_start, cells.cell_end, slot, position, visit);
  }
};

template <Backend B>
CellNeighbors neighbors_in(const Grid<B>& grid) {
  const std::uint32_t* start = grid.cell_start.data();
  return {{grid.levels, start, grid.levels.count > 1 ? start + 1 : grid.cell_end.data()}};
}

}  // namespace fastcollide
