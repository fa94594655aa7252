// Where a pass finds the spheres near one in grids of several levels.
#pragma once

#include "../physics/levels.hpp"
#include "neighbor_lists.hpp"

namespace fastcollide {

// The slots that hold, among others, all spheres of a level whose centres are within `reach` of a place, one after the
// other; rows of cells are shared among the lanes. Where there are many rows, each is cut to what the ball covers: a
// large sphere is full of cells of small ones.
class BallSearch {
 public:
  FC_HOST_DEVICE void start(const CellLevel& level, Vec3 position, float reach, Lane lane) {
    const GridShape& shape = level.shape;
    xs_ = cells_within(position.x, reach, shape.x);
    ys_ = cells_within(position.y, reach, shape.y);
    zs_ = cells_within(position.z, reach, shape.z);
    reach_ = reach;
    y_ = lane.index;
    z_ = rest_ = 0;
  }

  // The next run of slots; false where there is none.
  FC_HOST_DEVICE bool next_run(const CellLevel& level, const std::uint32_t* cell_start, const std::uint32_t* cell_end,
                               Vec3 position, Lane lane, std::uint32_t& begin, std::uint32_t& end) {
    const GridShape& shape = level.shape;
    if (rest_ > 0) {  // the row has gone round
      begin = cell_start[row_];
      end = cell_end[row_ + static_cast<std::uint32_t>(rest_ - 1)];
      rest_ = 0;
      return true;
    }
    for (;; y_ += lane.count) {
      for (; y_ >= ys_.count; y_ -= ys_.count) ++z_;
      if (z_ >= zs_.count) return false;
      if (ys_.count * zs_.count <= few_rows || cut_row(shape, position)) break;
    }
    const Vec3i first{0, cell_in_range(ys_, y_, shape.y), cell_in_range(zs_, z_, shape.z)};
    row_ = level.first_cell + cell_hash(first, shape);
    const int inside = xs_.first + xs_.count <= shape.x.cells ? xs_.count : shape.x.cells - xs_.first;
    begin = cell_start[row_ + static_cast<std::uint32_t>(xs_.first)];
    end = cell_end[row_ + static_cast<std::uint32_t>(xs_.first + inside - 1)];
    rest_ = xs_.count - inside;
    y_ += lane.count;
    return true;
  }

 private:
  static constexpr int few_rows = 16;

  // False where the row lies outside the ball.
  FC_HOST_DEVICE bool cut_row(const GridShape& shape, Vec3 position) {
    const float off_y = distance_of_cell(ys_, y_, position.y, reach_, shape.y);
    const float off_z = distance_of_cell(zs_, z_, position.z, reach_, shape.z);
    const float left = 1.00001f * (reach_ * reach_) - (off_y * off_y + off_z * off_z);  // the rest is rounding
    if (left <= 0.0f) return false;
    xs_ = cells_within(position.x, square_root(left), shape.x);
    return true;
  }

  CellRange xs_, ys_, zs_;
  float reach_;
  int y_, z_;          // the next row
  std::uint32_t row_;  // the first cell of the last one
  int rest_;           // cells of it that have not been looked at
};

struct LevelNeighbors {
  CellLevels levels;
  const std::uint32_t *cell_start, *cell_end;

  // Near ones are kept until there are many, or no more: finding them takes each lane of a GPU another way, visiting
  // them does not.
  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, Visit& visit) const {
    constexpr int most = 24;
    std::uint32_t near[most];
    const float radius = grid.position_radius[slot].w;
    BallSearch search;
    float range = 0.0f;
    std::uint32_t other = 0, end = 0;
    int k = -1;
    bool is_level_done = true;
    for (bool is_done = false; !is_done;) {
      int found = 0;
      while (found < most) {
        if (other < end) {
          const Vec4 there = grid.position_radius[other];
          const Vec3 offset = separation(position, {there.x, there.y, there.z}, grid.period);
          const float reach = (range + there.w) * 1.00001f;
          if (dot(offset, offset) <= reach * reach && other != slot) near[found++] = other;
          ++other;
        } else if (is_level_done) {
          is_done = ++k == levels.count;
          if (is_done) break;
          const CellLevel& level = levels.levels[k];
          range = radius + margin_of_pair(radius, level.largest_radius, levels.margin);
          search.start(level, position, range + level.largest_radius, lane);
          is_level_done = false;
        } else {
          is_level_done = !search.next_run(levels.levels[k], cell_start, cell_end, position, lane, other, end);
        }
      }
      for (int i = 0; i < found; ++i) visit(near[i]);
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
