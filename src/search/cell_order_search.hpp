// The search on a CPU: spheres in cell order, so that what lies side by side in space lies side by side in memory.
//
//   search_slots(input, begin, end, sink)
//
// finds for each sphere in the slots [begin, end) those within reach and calls sink(count, queries, slots) with some of
// them at a time. In one set each pair is found once: from the smaller of two levels, or the earlier slot. Slots can be
// cut among threads in any way. It takes plain pointers: whoever has spheres in cell order can call it.
#pragma once

#include <algorithm>
#include <array>

#include "filter_runs.hpp"
#include "search_grid.hpp"

namespace fastcollide::search {

template <class T>
struct SlotSearch {
  SearchGrid<T> grid;
  const std::uint32_t* cell_start;  // one more than cells
  // Of the spheres that search and of the slots of the grid; where they are the same set, the same pointers.
  FilterInput<T> spheres;
  bool is_one_set;
  FilterRuns<T> filter;
};

// Runs are collected until there are enough to be worth a call.
template <class T, class Sink>
class RunBatch {
 public:
  RunBatch(const SlotSearch<T>& input, Sink& sink) : input_(input), sink_(sink) {}

  void add(std::uint32_t query, std::uint32_t begin, std::uint32_t end, int image) {
    // Written without a branch: whether a run is empty is hard to predict.
    const std::uint32_t length = end > begin ? end - begin : 0;
    runs_[static_cast<std::size_t>(run_count_)] = {query, begin, end, image};
    run_count_ += length > 0 ? 1 : 0;
    candidates_ += length;
    if (candidates_ > most_candidates || run_count_ == most_runs) [[unlikely]]
      make_room();
  }

  void flush() {
    if (run_count_ == 0) return;
    const std::int64_t hits = input_.filter(input_.spheres, runs_.data(), run_count_, queries_.data(), slots_.data());
    if (hits > 0) sink_(hits, queries_.data(), slots_.data());
    run_count_ = 0;
    candidates_ = 0;
  }

 private:
  // The last run may be too long for what is left, or for all there is: it goes part by part.
  void make_room() {
    Run last = runs_[static_cast<std::size_t>(--run_count_)];
    candidates_ -= last.end - last.begin;
    flush();
    while (last.begin < last.end) {
      const std::uint32_t part = std::min<std::uint32_t>(last.end - last.begin, most_candidates);
      runs_[0] = {last.query, last.begin, last.begin + part, last.image};
      run_count_ = 1;
      candidates_ = part;
      last.begin += part;
      if (last.begin < last.end) flush();
    }
  }

  static constexpr int most_runs = 512;
  static constexpr std::uint32_t most_candidates = 8192;  // 64 KiB of hits: they stay in the cache

  const SlotSearch<T>& input_;
  Sink& sink_;
  int run_count_ = 0;
  std::uint32_t candidates_ = 0;
  std::array<Run, most_runs> runs_;
  std::array<std::uint32_t, most_candidates + slot_padding> queries_, slots_;
};

// cell_at() of many places, in a plain loop that compilers turn into vector instructions.
template <class T>
void cells_at(const CellAxis<T>& axis, const T* places, std::int64_t count, int* cells) {
  CellAxis<T> held = axis;
  if (axis.goes_round) {
    for (std::int64_t i = 0; i < count; ++i) cells[i] = cell_at(places[i], held);
    return;
  }
  held.goes_round = false;  // known to the compiler, too
  for (std::int64_t i = 0; i < count; ++i) cells[i] = cell_at(places[i], held);
}

// Windows of many spheres at once, in plain loops that compilers turn into vector instructions.
template <class T>
class WindowBlock {
 public:
  static constexpr int size = 64;

  // For `count` spheres from the n-th on.
  void compute(const SearchGrid<T>& grid, int k, const FilterInput<T>& spheres, std::int64_t n, int count) {
    const Level<T>& level = grid.levels[k];
    const T half_margin = static_cast<T>(grid.half_margin);
    if (spheres.query_radii == nullptr) {
      std::fill_n(reach_.data(), count, reach_into(level, T(0), half_margin));
    } else {
      for (int i = 0; i < count; ++i) reach_[i] = reach_into(level, spheres.query_radii[n + i], half_margin);
    }
    compute(level.x, spheres.query_x + n, count, x_);
    compute(level.y, spheres.query_y + n, count, y_);
    compute(level.z, spheres.query_z + n, count, z_);
    cells_at(level.y, spheres.query_y + n, count, own_y_.data());
    cells_at(level.z, spheres.query_z + n, count, own_z_.data());
  }

  T reach(int i) const { return reach_[i]; }
  Window x(int i) const { return {x_.first[i], x_.last[i]}; }
  Window y(int i) const { return {y_.first[i], y_.last[i]}; }
  Window z(int i) const { return {z_.first[i], z_.last[i]}; }
  // The row of the sphere itself; only where no axis of the level goes round.
  int own_y(int i) const { return own_y_[i]; }
  int own_z(int i) const { return own_z_[i]; }

 private:
  using Numbers = std::array<int, size>;
  struct Windows {
    Numbers first, last;
  };

  void compute(const CellAxis<T>& axis, const T* x, int count, Windows& windows) const {
    CellAxis<T> held = axis;
    if (axis.goes_round) {
      for (int i = 0; i < count; ++i) {
        const Window window = window_around(x[i], reach_[i], held);
        windows.first[i] = window.first;
        windows.last[i] = window.last;
      }
      return;
    }
    held.goes_round = false;  // known to the compiler, too
    for (int i = 0; i < count; ++i) {
      const T pad = padded(x[i], reach_[i]);
      windows.first[i] = cell_at(x[i] - pad, held);
      windows.last[i] = cell_at(x[i] + pad, held);
    }
  }

  std::array<T, size> reach_;
  Windows x_, y_, z_;
  Numbers own_y_, own_z_;
};

// Adds the runs of one level for a block of spheres. `is_own`: pairs with slots up to the sphere's own are left out.
template <class T, class Sink>
void add_runs(const SlotSearch<T>& input, int k, bool is_own, std::int64_t n, int count, WindowBlock<T>& windows,
              RunBatch<T, Sink>& batch) {
  const SearchGrid<T>& grid = input.grid;
  const Level<T>& level = grid.levels[k];
  const bool goes_round = level.x.goes_round || level.y.goes_round || level.z.goes_round;
  const bool is_periodic = grid.period.is_any();
  const std::uint32_t* cell_start = input.cell_start + level.first_cell;
  windows.compute(grid, k, input.spheres, n, count);
  for (int i = 0; i < count; ++i) {
    const auto query = static_cast<std::uint32_t>(n + i);
    const std::uint32_t first_slot = is_own ? query + 1 : 0;
    auto visit_run = [&](std::uint32_t first, std::uint32_t last) {
      batch.add(query, std::max(first, first_slot), last, no_image);
    };
    if (goes_round) {
      visit_runs(level, input.cell_start, windows.x(i), windows.y(i), windows.z(i), 0, visit_run);
    } else {
      const Window x = windows.x(i), y = windows.y(i), z = windows.z(i);
      // In its own level a sphere starts with its own row: those before hold earlier slots alone. All rows in one loop,
      // as the end of each is hard to predict.
      const int row_z = is_own ? windows.own_z(i) : z.first;
      int row_y = is_own ? windows.own_y(i) : y.first;
      const std::uint32_t* cells = cell_start + static_cast<std::int64_t>(level.x.cells) *
                                                    (row_y + static_cast<std::int64_t>(level.y.cells) * row_z);
      const std::int64_t to_next_layer =
          static_cast<std::int64_t>(level.x.cells) * (level.y.cells - (y.last - y.first));
      int rows = (y.last - row_y + 1) + (z.last - row_z) * (y.last - y.first + 1);
      for (; rows > 0; --rows) {
        visit_run(cells[x.first], cells[x.last + 1]);
        const bool is_last = row_y == y.last;
        row_y = is_last ? y.first : row_y + 1;
        cells += is_last ? to_next_layer : level.x.cells;
      }
    }
    if (is_periodic) {
      auto visit_image = [&](std::uint32_t first, std::uint32_t last, int image) {
        batch.add(query, std::max(first, first_slot), last, image);
      };
      const Point<T> p{input.spheres.query_x[n + i], input.spheres.query_y[n + i], input.spheres.query_z[n + i]};
      visit_images(grid, k, input.cell_start, p, windows.reach(i), 0, false, visit_image);
    }
  }
}

template <class T, class Sink>
void search_slots(const SlotSearch<T>& input, std::int64_t begin, std::int64_t end, Sink& sink) {
  const SearchGrid<T>& grid = input.grid;
  RunBatch<T, Sink> batch(input, sink);
  WindowBlock<T> windows;
  // The level of the spheres that search, and where it ends: levels come one after the other. Another set has none.
  int own = input.is_one_set ? -1 : grid.level_count;
  std::int64_t own_end = input.is_one_set ? 0 : end;
  for (std::int64_t n = begin; n < end;) {
    while (n >= own_end) {
      ++own;
      own_end = input.cell_start[own + 1 < grid.level_count ? grid.levels[own + 1].first_cell : grid.cell_count];
    }
    const int count = static_cast<int>(std::min<std::int64_t>(WindowBlock<T>::size, std::min(own_end, end) - n));
    for (int k = 0; k < grid.level_count && k <= own; ++k) add_runs(input, k, k == own, n, count, windows, batch);
    n += count;
  }
  batch.flush();
}

}  // namespace fastcollide::search
