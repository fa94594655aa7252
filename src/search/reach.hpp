// Are two spheres within reach of each other? Decided in double precision, whatever the type of the input.
#pragma once

#include "point.hpp"

namespace fastcollide::search {

struct Reach {
  double margin;  // with twice the common radius, where there is one
  bool is_inclusive;
  Period period;
};

FC_HOST_DEVICE inline double square_root(double x) {
#if defined(__CUDA_ARCH__)
  return __dsqrt_rn(x);
#else
  return std::sqrt(x);
#endif
}

// From a's image to b. Swapping a and b, with the opposite image, turns the sign and keeps every other bit.
template <class T>
FC_HOST_DEVICE inline Point<double> offset_between(Point<T> a, Point<T> b, Point<double> shift) {
  return {(static_cast<double>(b.x) - static_cast<double>(a.x)) - shift.x,
          (static_cast<double>(b.y) - static_cast<double>(a.y)) - shift.y,
          (static_cast<double>(b.z) - static_cast<double>(a.z)) - shift.z};
}

FC_HOST_DEVICE inline double squared_length(Point<double> a) { return a.x * a.x + a.y * a.y + a.z * a.z; }

template <class T>
FC_HOST_DEVICE inline bool is_near_enough(double distance_squared, T radius_a, T radius_b, const Reach& reach) {
  const double limit = (static_cast<double>(radius_a) + static_cast<double>(radius_b)) + reach.margin;
  return distance_squared < limit * limit || (reach.is_inclusive && distance_squared == limit * limit);
}

template <class T>
FC_HOST_DEVICE inline bool is_within_reach(Point<T> a, T radius_a, Point<T> b, T radius_b, Point<double> shift,
                                           const Reach& reach) {
  return is_near_enough(squared_length(offset_between(a, b, shift)), radius_a, radius_b, reach);
}

FC_HOST_DEVICE inline double to_nearest_image(double difference, double period) {
  if (period > 0) {
    if (difference > 0.5 * period) return difference - period;
    if (difference < -0.5 * period) return difference + period;
  }
  return difference;
}

template <class T>
FC_HOST_DEVICE inline Point<double> nearest_offset(Point<T> a, Point<T> b, const Period& period) {
  const Point<double> offset = offset_between(a, b, {0, 0, 0});
  return {to_nearest_image(offset.x, period.x), to_nearest_image(offset.y, period.y),
          to_nearest_image(offset.z, period.z)};
}

template <class T>
struct Surfaces {
  T gap;            // from surface to surface, negative in overlap
  Point<T> normal;  // from a to b
};

// Measured in double precision, rounded once.
template <class T>
FC_HOST_DEVICE inline Surfaces<T> surfaces_between(Point<T> a, Point<T> b, double reach, const Period& period) {
  const Point<double> offset = nearest_offset(a, b, period);
  const double distance = square_root(squared_length(offset));
  const T gap = static_cast<T>(distance - reach);
  if (!(distance > 1e-150)) return {gap, {T(-1), T(0), T(0)}};  // the rule of World.contacts
  return {
      gap,
      {static_cast<T>(offset.x / distance), static_cast<T>(offset.y / distance), static_cast<T>(offset.z / distance)}};
}

}  // namespace fastcollide::search
