// Measures of found pairs, and rows cut to their nearest.
#pragma once

#include "problem.hpp"
#include "sort_row.hpp"

namespace fastcollide::search {

template <class T>
struct MeasureContacts {
  SpheresIn<T> spheres, targets;
  Period period;
  double common_radii;  // twice the radius that all share
  std::int64_t count;
  const std::int32_t* first;
  const std::int32_t* second;
  T* gap;
  Point<T>* normal;

  FC_HOST_DEVICE void operator()(std::int64_t k) const {
    if (k + far_ahead < count) targets.fetch(second[k + far_ahead]);
    const std::int64_t i = first[k], j = second[k];
    const double radii =
        (static_cast<double>(spheres.radius(i)) + static_cast<double>(targets.radius(j))) + common_radii;
    const Surfaces<T> surfaces = surfaces_between(spheres.position(i), targets.position(j), radii, period);
    gap[k] = surfaces.gap;
    normal[k] = surfaces.normal;
  }
};

template <class T>
struct MeasureDistances {
  SpheresIn<T> spheres, targets;
  Period period;
  bool is_squared;
  const std::int64_t* offsets;
  const std::int32_t* columns;
  T* distances;

  FC_HOST_DEVICE void operator()(std::int64_t row) const {
    const Point<T> p = spheres.position(row);
    for (std::int64_t k = offsets[row]; k < offsets[row + 1]; ++k) {
      const double squared = squared_length(nearest_offset(p, targets.position(columns[k]), period));
      distances[k] = static_cast<T>(is_squared ? squared : square_root(squared));
    }
  }
};

// By distance, ties by index; or by index.
template <class T>
struct SortNeighbors {
  bool by_distance;
  const std::int64_t* offsets;
  std::int32_t* columns;
  T* distances;

  FC_HOST_DEVICE void operator()(std::int64_t row) const {
    std::int32_t* index = columns + offsets[row];
    T* distance = distances + offsets[row];
    const bool nearest_first = by_distance;
    sort_row(
        offsets[row + 1] - offsets[row],
        [=](std::int64_t a, std::int64_t b) {
          if (nearest_first && distance[a] != distance[b]) return distance[a] < distance[b];
          return index[a] < index[b];
        },
        [=](std::int64_t a, std::int64_t b) {
          exchange(index[a], index[b]);
          exchange(distance[a], distance[b]);
        });
  }
};

struct CountShortened {
  const std::int64_t* offsets;
  std::int64_t most;

  FC_HOST_DEVICE std::int64_t operator()(std::int64_t row) const {
    return offsets[row + 1] - offsets[row] > most ? 1 : 0;
  }
};

struct ShortenRows {
  const std::int64_t* offsets;
  std::int64_t most;
  std::int64_t* shorter;

  FC_HOST_DEVICE void operator()(std::int64_t row) const {
    const std::int64_t count = offsets[row + 1] - offsets[row];
    shorter[row] = count < most ? count : most;
  }
};

template <class T>
struct CopyRows {
  const std::int64_t *from, *to;
  const std::int32_t* columns;
  const T* distances;
  std::int32_t* kept_columns;
  T* kept_distances;

  FC_HOST_DEVICE void operator()(std::int64_t row) const {
    for (std::int64_t k = to[row]; k < to[row + 1]; ++k) {
      kept_columns[k] = columns[from[row] + (k - to[row])];
      kept_distances[k] = distances[from[row] + (k - to[row])];
    }
  }
};

}  // namespace fastcollide::search
