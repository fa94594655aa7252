// The search as stages on any backend: hash, sort, cell starts; then count, scan, fill. Nothing is dropped, whatever
// the number.
#pragma once

#include <bit>

#include "problem.hpp"
#include "sort_row.hpp"

namespace fastcollide::search {

template <class T>
struct HashSpheres {
  SpheresIn<T> spheres;
  SearchGrid<T> grid;
  std::uint32_t* cells;
  std::uint32_t* ids;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    cells[i] = cell_of(spheres.position(i), grid.levels[level_of(spheres.radius(i), grid)]);
    ids[i] = static_cast<std::uint32_t>(i);
  }
};

template <class T>
struct CopySlots {
  SpheresIn<T> spheres;
  std::uint32_t cell_count;
  const std::uint32_t* cells;
  const std::uint32_t* ids;
  std::uint32_t* cell_start;
  T* x;
  T* y;
  T* z;
  T* radii;  // or null

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    // The first slot of a cell also starts the empty cells before it; the last slot ends all that are left.
    const std::uint32_t cell = cells[slot];
    for (std::uint32_t c = slot == 0 ? 0 : cells[slot - 1] + 1; c <= cell; ++c) {
      cell_start[c] = static_cast<std::uint32_t>(slot);
    }
    if (slot == spheres.count - 1) {
      for (std::uint32_t c = cell + 1; c <= cell_count; ++c) cell_start[c] = static_cast<std::uint32_t>(slot + 1);
    }
    const std::uint32_t id = ids[slot];
    const Point<T> p = spheres.position(id);
    x[slot] = p.x;
    y[slot] = p.y;
    z[slot] = p.z;
    if (radii != nullptr) radii[slot] = spheres.radius(id);
  }
};

template <class T>
struct Search {
  Problem<T> problem;
  CellOrderView<T> order;

  // Calls visit(i, j) for each pair that the sphere finds: in one set those with later slots of its own level and those
  // of coarser levels, so that each pair is found once; of two sets all.
  template <class Visit>
  FC_HOST_DEVICE void visit_pairs(std::int64_t n, Visit& visit) const {
    const bool is_one_set = problem.is_one_set;
    const Point<T> p = is_one_set ? order.position(n) : problem.spheres.position(n);
    const T radius = is_one_set ? order.radius(n) : problem.spheres.radius(n);
    const std::uint32_t id = is_one_set ? order.ids[n] : static_cast<std::uint32_t>(n);
    const int own = is_one_set ? level_of(radius, problem.grid) : problem.grid.level_count;
    for (int k = 0; k < problem.grid.level_count && k <= own; ++k) {
      auto visit_run = [&](std::uint32_t begin, std::uint32_t end, int image) {
        if (k == own && begin <= n) begin = static_cast<std::uint32_t>(n) + 1;
        for (std::uint32_t slot = begin; slot < end; ++slot) {
          if (is_within_reach(p, radius, order.position(slot), order.radius(slot), problem.grid.period.shift(image),
                              problem.reach)) {
            visit(id, order.ids[slot]);
          }
        }
      };
      const Level<T>& level = problem.grid.levels[k];
      visit_images(problem.grid, k, order.cell_start, p,
                   reach_into(level, radius, static_cast<T>(problem.grid.half_margin)), k == own ? row_of(p, level) : 0,
                   true, visit_run);
    }
  }
};

template <class T>
struct CountFound {
  Search<T> search;
  std::int64_t* total;

  FC_HOST_DEVICE void operator()(std::int64_t n) const {
    std::int64_t count = 0;
    auto visit = [&](std::uint32_t, std::uint32_t) { ++count; };
    search.visit_pairs(n, visit);
    if (count > 0) atomic_add(total, count);
  }
};

template <class T>
struct CountRows {
  Search<T> search;
  Rows rows;
  std::int64_t* counts;

  FC_HOST_DEVICE void operator()(std::int64_t n) const {
    auto visit = [&](std::uint32_t i, std::uint32_t j) {
      if (search.problem.is_one_set && rows == Rows::both) {
        atomic_add(counts + i, 1);
        atomic_add(counts + j, 1);
      } else {
        atomic_add(counts + (search.problem.is_one_set && j < i ? j : i), 1);
      }
    };
    search.visit_pairs(n, visit);
  }
};

template <class T>
struct FillRows {
  Search<T> search;
  Rows rows;
  std::int64_t* next;  // place in each row
  std::int32_t* columns;

  FC_HOST_DEVICE void operator()(std::int64_t n) const {
    auto visit = [&](std::uint32_t i, std::uint32_t j) {
      const bool is_turned = search.problem.is_one_set && rows == Rows::once && j < i;
      const std::uint32_t row = is_turned ? j : i, column = is_turned ? i : j;
      columns[atomic_add(next + row, 1)] = static_cast<std::int32_t>(column);
      if (search.problem.is_one_set && rows == Rows::both) {
        columns[atomic_add(next + column, 1)] = static_cast<std::int32_t>(row);
      }
    };
    search.visit_pairs(n, visit);
  }
};

struct SortRows {
  const std::int64_t* offsets;
  Columns to;

  FC_HOST_DEVICE void operator()(std::int64_t row) const {
    std::int32_t* here = to.columns + offsets[row];
    sort_row(
        offsets[row + 1] - offsets[row], [here](std::int64_t a, std::int64_t b) { return here[a] < here[b]; },
        [here](std::int64_t a, std::int64_t b) { exchange(here[a], here[b]); });
    if (to.rows == nullptr) return;
    for (std::int64_t k = offsets[row]; k < offsets[row + 1]; ++k) to.rows[k] = static_cast<std::int32_t>(row);
  }
};

template <Backend B, class T>
class GenericSearcher {
 public:
  static constexpr CellEdges edges{1.0, 1.0};
  static constexpr std::int64_t group_size = 1;
  static constexpr bool needs_offsets = true;  // of rows, to find their entries

  explicit GenericSearcher(B& backend) : backend_(backend) {}

  void build(const Problem<T>& problem) {
    const SpheresIn<T>& spheres = problem.targets;
    const std::int64_t n = spheres.count;
    for (auto* buffer : {&unsorted_cells_, &unsorted_ids_, &cells_, &order_.ids}) buffer->resize(n);
    for (auto* buffer : {&order_.x, &order_.y, &order_.z}) buffer->resize(n);
    order_.radii.resize(spheres.radii == nullptr ? 0 : n);
    order_.cell_start.resize(std::int64_t(problem.grid.cell_count) + 1);
    backend_.for_each(n, HashSpheres<T>{spheres, problem.grid, unsorted_cells_.data(), unsorted_ids_.data()});
    backend_.sort_pairs(static_cast<const std::uint32_t*>(unsorted_cells_.data()), cells_.data(),
                        static_cast<const std::uint32_t*>(unsorted_ids_.data()), order_.ids.data(), n,
                        std::bit_width(problem.grid.cell_count - 1));
    backend_.for_each(n, CopySlots<T>{spheres, problem.grid.cell_count, cells_.data(), order_.ids.data(),
                                      order_.cell_start.data(), order_.x.data(), order_.y.data(), order_.z.data(),
                                      spheres.radii == nullptr ? nullptr : order_.radii.data()});
  }

  // Indices in the order of slots, of the last problem that was built; searchers of another set keep their own order.
  const std::uint32_t* target_ids() const { return order_.ids.data(); }
  const std::uint32_t* searcher_ids() const { return nullptr; }

  std::int64_t count(const Problem<T>& problem) {
    next_.resize(1);
    backend_.fill_zero(next_.data(), 1);
    backend_.for_each(problem.spheres.count, CountFound<T>{search(problem), next_.data()});
    std::int64_t total = 0;
    backend_.copy_to_host(&total, static_cast<const std::int64_t*>(next_.data()), 1);
    return total;
  }

  // counts: one for each row, as zeros.
  void count_rows(const Problem<T>& problem, Rows rows, std::int64_t* counts) {
    backend_.for_each(problem.spheres.count, CountRows<T>{search(problem), rows, counts});
  }

  // Offsets of the rows, one more than rows, and through allocate(total) the columns of each, ascending.
  template <class Refuse, class Allocate>
  std::int64_t find(const Problem<T>& problem, Rows rows, std::int64_t* offsets, const Refuse& refuse_if_too_many,
                    const Allocate& allocate) {
    const std::int64_t n = problem.spheres.count;
    backend_.fill_zero(offsets, n);
    count_rows(problem, rows, offsets);
    backend_.exclusive_scan(offsets, n);
    std::int64_t total = 0;
    backend_.copy_to_host(&total, static_cast<const std::int64_t*>(offsets) + n, 1);
    refuse_if_too_many(total);
    const Columns to = allocate(total);
    next_.resize(n);
    backend_.copy(next_.data(), static_cast<const std::int64_t*>(offsets), n);
    backend_.for_each(n, FillRows<T>{search(problem), rows, next_.data(), to.columns});
    backend_.for_each(n, SortRows{offsets, to});
    return total;
  }

 private:
  Search<T> search(const Problem<T>& problem) { return {problem, view_of(order_)}; }

  B& backend_;
  CellOrder<B, T> order_{backend_};
  typename B::template Buffer<std::uint32_t> unsorted_cells_{backend_}, unsorted_ids_{backend_}, cells_{backend_};
  typename B::template Buffer<std::int64_t> next_{backend_};
};

}  // namespace fastcollide::search
