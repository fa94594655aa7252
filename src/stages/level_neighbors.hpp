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
  const CellLevels* levels;
  const std::uint32_t *cell_start, *cell_end;

  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, Visit& visit) const {
    constexpr std::uint32_t most = 96;
    std::uint32_t kept[most];
    const auto near = [&](std::uint32_t k) -> std::uint32_t& { return kept[k]; };
    const auto flush = [&](std::uint32_t found) {
      for (std::uint32_t i = 0; i < found; ++i) visit(kept[i]);
    };
    search(grid, slot, position, lane, LanesTogether{}, true, near, most, flush);
  }

  // Calls visit(begin, end) with slots among which are all that are near, as long as that returns true.
  template <class Visit>
  FC_HOST_DEVICE void visit_runs(const GridView& grid, std::int64_t slot, Visit& visit) const {
    const Vec4 self = grid.position_radius[slot];
    const Vec3 position{self.x, self.y, self.z};
    for (int k = 0; k < levels->count; ++k) {
      const CellLevel& level = levels->levels[k];
      const float largest = level.largest_radius;
      BallSearch search;
      search.start(level, position, self.w + margin_of_pair(self.w, largest, levels->margin) + largest, Lane{});
      std::uint32_t begin, end;
      while (search.next_run(level, cell_start, cell_end, position, Lane{}, begin, end)) {
        if (begin != end && !visit(begin, end)) return;
      }
    }
  }

  // Near ones are kept, near(0) and so on, until there are many, or no more: to find them takes each lane of a GPU
  // another way, to work on them does not. On the way to them the lanes of a warp go in step, too: each step is a new
  // row for those that need one, and then some candidates of each lane. All of them call flush(found) when one has less
  // room than that, and at the end. One that `keeps` none finds none.
  template <class Near, class Flush>
  FC_HOST_DEVICE void search(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, LanesTogether together,
                             bool keeps, const Near& near, std::uint32_t most, const Flush& flush) const {
#if defined(__CUDA_ARCH__)
    constexpr std::uint32_t at_once = 4;  // candidates that a lane waits for together
#else
    constexpr std::uint32_t at_once = 1;
#endif
    std::uint32_t found = 0;
    const auto self = static_cast<std::uint32_t>(slot);
    const float radius = grid.position_radius[slot].w;
    const int count = levels->count;
    for (int k = 0; k < count; ++k) {
      const CellLevel& level = levels->levels[k];
      const float range = radius + margin_of_pair(radius, level.largest_radius, levels->margin);
      BallSearch search;
      search.start(level, position, range + level.largest_radius, lane);
      std::uint32_t other = 0, end = 0;
      for (bool goes_on = true; goes_on;) {
        bool has_more = keeps;
        if (keeps && other == end) {
          has_more = search.next_run(level, cell_start, cell_end, position, lane, other, end);
        }
        Vec4 there[at_once];
        FC_UNROLL
        for (std::uint32_t i = 0; i < at_once; ++i) there[i] = grid.position_radius[other + i < end ? other + i : self];
        FC_UNROLL
        for (std::uint32_t i = 0; i < at_once; ++i) {
          const Vec3 offset = separation(position, {there[i].x, there[i].y, there[i].z}, grid.period);
          const float reach = (range + there[i].w) * 1.00001f;
          const bool is_near = dot(offset, offset) <= reach * reach;
          if (is_near & (other + i < end) & (other + i != self)) near(found++) = other + i;
        }
        other = end - other < at_once ? end : other + at_once;
        goes_on = together.any(has_more);
        const bool is_last = !goes_on && k + 1 == count;
        if (together.any(found + at_once > most) || is_last) {
          flush(found);
          found = 0;
        }
      }
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
  CellLevels levels;
  const std::uint32_t *cell_start, *cell_end;

  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, Visit& visit) const {
    if (levels.count > 1) {
      return LevelNeighbors{&levels, cell_start, cell_end}.visit(grid, slot, position, lane, visit);
    }
    visit_adjacent_cells(levels.levels[0].shape, cell_start, cell_end, slot, position, visit);
  }
};

template <Backend B>
CellNeighbors neighbors_in(const Grid<B>& grid) {
  const std::uint32_t* start = grid.cell_start.data();
  return {grid.levels, start, grid.levels.count > 1 ? start + 1 : grid.cell_end.data()};
}

}  // namespace fastcollide
