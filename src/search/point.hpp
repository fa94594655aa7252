// The user's arrays as a stage reads them: where they lie, with the steps they have.
#pragma once

#include <cstdint>

#include "../math.hpp"
#include "fastcollide/contacts.hpp"

namespace fastcollide::search {

template <class T>
struct Point {
  T x, y, z;
};

// Asks for memory that will be read soon: places known ahead, but not in order, are where a CPU would wait. A GPU has
// other threads to run meanwhile.
FC_HOST_DEVICE inline void fetch_ahead([[maybe_unused]] const void* place) {
#if !defined(__CUDA_ARCH__) && defined(__GNUC__)
  __builtin_prefetch(place);
#endif
}
// The same for memory that will be written: the line need not be waited for when a store has come.
inline void fetch_to_write([[maybe_unused]] const void* place) {
#if !defined(__CUDA_ARCH__) && defined(__GNUC__)
  __builtin_prefetch(place, 1);
#endif
}
inline constexpr std::int64_t far_ahead = 24;  // elements: about as many reads as a core has under way

template <class T>
struct SpheresIn {
  std::int64_t count = 0;
  const T* positions = nullptr;
  std::int64_t position_step = 3, component_step = 1;
  const T* radii = nullptr;  // null: their common radius is part of the margin
  std::int64_t radius_step = 1;

  FC_HOST_DEVICE Point<T> position(std::int64_t i) const {
    const T* p = positions + i * position_step;
    return {p[0], p[component_step], p[2 * component_step]};
  }
  FC_HOST_DEVICE T radius(std::int64_t i) const { return radii == nullptr ? T(0) : radii[i * radius_step]; }
  FC_HOST_DEVICE void fetch(std::int64_t i) const {
    fetch_ahead(positions + i * position_step);
    if (radii != nullptr) fetch_ahead(radii + i * radius_step);
  }
};

template <class T>
SpheresIn<T> spheres_in(const SphereArrays& arrays) {
  const ConstArray &x = arrays.positions, &r = arrays.radii;
  return {x.rows, static_cast<const T*>(x.data), x.row_step, x.column_step, static_cast<const T*>(r.data), r.row_step};
}

// Ends of the periodic axes, as the input's type rounds them.
template <class T>
struct Bounds {
  T lower[3], upper[3];
  bool is_periodic[3];
};

// The images of the box along its periodic axes, numbered 0 ... 26 by steps of -1, 0, 1 along x, y, z.
inline constexpr int no_image = 13;

struct Period {
  double x = 0, y = 0, z = 0;  // lengths of the periodic axes, 0 for the others

  FC_HOST_DEVICE bool is_any() const { return x > 0 || y > 0 || z > 0; }
  FC_HOST_DEVICE Point<double> shift(int image) const {
    return {x * (image % 3 - 1), y * (image / 3 % 3 - 1), z * (image / 9 - 1)};
  }
};

}  // namespace fastcollide::search
