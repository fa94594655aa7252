// The list of all overlapping pairs: count, scan, fill. Nothing is dropped, whatever the number.
#pragma once

#include "../physics/overlap.hpp"
#include "level_neighbors.hpp"

namespace fastcollide {

// Calls visit(other) for each slot whose sphere overlaps this one and has a larger id: every pair once.
template <class Visit>
FC_HOST_DEVICE inline void visit_pairs_of(const GridView& grid, const CellNeighbors& neighbors, std::int64_t slot,
                                          Visit& visit) {
  const Vec4 here = grid.position_radius[slot];
  const Vec3 position{here.x, here.y, here.z};
  const std::uint32_t id = grid.mass_ids[slot].id;
  auto visit_candidate = [&](std::int64_t other) {
    // In this order, as whether they overlap is easy to predict: mostly not.
    const Vec4 there = grid.position_radius[other];
    if (overlaps(position, here.w, {there.x, there.y, there.z}, there.w, grid.period) && grid.mass_ids[other].id > id) {
      visit(other);
    }
  };
  neighbors.visit(grid, slot, position, Lane{}, visit_candidate);
}

struct CountPairs {
  GridView grid;
  CellNeighbors neighbors;
  std::int64_t* counts;  // in the order of the ids

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    std::int64_t count = 0;
    auto visit = [&](std::int64_t) { ++count; };
    visit_pairs_of(grid, neighbors, slot, visit);
    counts[grid.mass_ids[slot].id] = count;
  }
};

// Sorts one row in place without extra memory: heap sort, as a row may have tens of thousands of entries.
FC_HOST_DEVICE inline void sort_row(std::uint32_t* row, std::int64_t count) {
  auto sift_down = [row](std::int64_t root, std::int64_t end) {
    for (std::int64_t child; (child = 2 * root + 1) < end; root = child) {
      if (child + 1 < end && row[child + 1] > row[child]) ++child;
      if (row[root] >= row[child]) return;
      const std::uint32_t held = row[root];
      row[root] = row[child];
      row[child] = held;
    }
  };
  for (std::int64_t root = count / 2; root-- > 0;) sift_down(root, count);
  for (std::int64_t end = count - 1; end > 0; --end) {
    const std::uint32_t largest = row[0];
    row[0] = row[end];
    row[end] = largest;
    sift_down(0, end);
  }
}

struct FillPairs {
  GridView grid;
  CellNeighbors neighbors;
  const std::int64_t* offsets;
  std::uint32_t* first;
  std::uint32_t* second;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const std::uint32_t id = grid.mass_ids[slot].id;
    const std::int64_t begin = offsets[id];
    std::int64_t next = begin;
    auto visit = [&](std::int64_t other) {
      first[next] = id;
      second[next] = grid.mass_ids[other].id;
      ++next;
    };
    visit_pairs_of(grid, neighbors, slot, visit);
    sort_row(second + begin, next - begin);
  }
};

struct MeasurePairs {
  Vec3 period;
  const Vec3* positions;
  const float* radii;
  const std::uint32_t* first;
  const std::uint32_t* second;
  float* gap;
  Vec3* normal;

  FC_HOST_DEVICE void operator()(std::int64_t pair) const {
    const std::uint32_t i = first[pair], j = second[pair];
    const ContactGeometry contact = contact_geometry(positions[j], radii[j], j, positions[i], radii[i], i, period);
    gap[pair] = -larger(contact.depth, 0.0f);  // decided in double precision, measured in single
    normal[pair] = contact.normal;
  }
};

template <Backend B>
std::int64_t count_pairs(B& backend, const Grid<B>& grid, Contacts<B>& contacts) {
  const std::int64_t count = grid.ids.size();
  contacts.offsets.resize(count + 1);
  backend.for_each(count, CountPairs{view_of(grid), neighbors_in(grid), contacts.offsets.data()});
  backend.exclusive_scan(contacts.offsets.data(), count);
  std::int64_t total = 0;
  backend.copy_to_host(&total, static_cast<const std::int64_t*>(contacts.offsets.data()) + count, 1);
  return total;
}

template <Backend B>
void find_pairs(B& backend, const Grid<B>& grid, const Bodies<B>& bodies, Contacts<B>& contacts) {
  const std::int64_t total = count_pairs(backend, grid, contacts);
  contacts.first.resize(total);
  contacts.second.resize(total);
  contacts.gap.resize(total);
  contacts.normal.resize(total);
  backend.for_each(grid.ids.size(), FillPairs{view_of(grid), neighbors_in(grid), contacts.offsets.data(),
                                              contacts.first.data(), contacts.second.data()});
  backend.for_each(total, MeasurePairs{grid.period, bodies.positions.data(), bodies.radii.data(), contacts.first.data(),
                                       contacts.second.data(), contacts.gap.data(), contacts.normal.data()});
}

}  // namespace fastcollide
