// What a search is given, and how its result is laid out.
#pragma once

#include "../backend/concept.hpp"
#include "search_grid.hpp"

namespace fastcollide::search {

template <class T>
struct Problem {
  SpheresIn<T> spheres;
  SpheresIn<T> targets;  // the other set, or the same
  bool is_one_set;
  Reach reach;
  SearchGrid<T> grid;  // over the targets
};

// once: a pair of one set stands in the row of its smaller index. both: in the rows of both. Of two sets, a pair stands
// in the row of the first.
enum class Rows : std::uint8_t { once, both };

// Where the entries of the rows go.
struct Columns {
  std::int32_t* columns;
  std::int32_t* rows;  // the row of each entry; or null
};

// The spheres of a grid in the order of (cell, index). A slot is a place in that order.
template <Backend B, class T>
struct CellOrder {
  explicit CellOrder(B& backend)
      : x(backend), y(backend), z(backend), radii(backend), ids(backend), cell_start(backend) {}

  typename B::template Buffer<T> x, y, z, radii;          // no radii where all are the same
  typename B::template Buffer<std::uint32_t> ids;         // index in the input
  typename B::template Buffer<std::uint32_t> cell_start;  // one more than cells
};

template <class T>
struct CellOrderView {
  const T *x, *y, *z, *radii;
  const std::uint32_t* ids;
  const std::uint32_t* cell_start;

  FC_HOST_DEVICE Point<T> position(std::int64_t slot) const { return {x[slot], y[slot], z[slot]}; }
  FC_HOST_DEVICE T radius(std::int64_t slot) const { return radii == nullptr ? T(0) : radii[slot]; }
};

template <Backend B, class T>
CellOrderView<T> view_of(const CellOrder<B, T>& order) {
  return {order.x.data(),   order.y.data(),
          order.z.data(),   order.radii.size() > 0 ? order.radii.data() : nullptr,
          order.ids.data(), order.cell_start.data()};
}

}  // namespace fastcollide::search
