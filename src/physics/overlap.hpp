// Do two spheres overlap? Decided as in double precision, mostly at the cost of single precision.
#pragma once

#include "box.hpp"

namespace fastcollide {

// d² < (r_i + r_j)² with every operation in double precision. Spheres that just touch do not overlap.
FC_HOST_DEVICE inline bool overlaps_in_double(Vec3 a, float radius_a, Vec3 b, float radius_b, Vec3 period) {
  const double x = nearest_image(static_cast<double>(a.x) - static_cast<double>(b.x), period.x);
  const double y = nearest_image(static_cast<double>(a.y) - static_cast<double>(b.y), period.y);
  const double z = nearest_image(static_cast<double>(a.z) - static_cast<double>(b.z), period.z);
  const double reach = static_cast<double>(radius_a) + static_cast<double>(radius_b);
  return x * x + y * y + z * z < reach * reach;
}

// The same answer. In single precision d² is off by at most 5 and (r_i + r_j)² by at most 3 units of 2^-24, relative:
// only a difference below 2^-20, twice that, needs double precision. (Radii below 1e-15 m would leave the range of
// normal numbers when squared; the world refuses them.) Across a periodic end a coordinate difference is off by up to
// period 2^-24, and d² by 2 d times that along each axis.
FC_HOST_DEVICE inline bool overlaps(Vec3 a, float radius_a, Vec3 b, float radius_b, Vec3 period) {
  const Vec3 offset = separation(a, b, period);
  const float distance_squared = dot(offset, offset);
  const float reach = radius_a + radius_b;
  const float reach_squared = reach * reach;
  const float doubt = reach_squared * 0x1p-20f + reach * (period.x + period.y + period.z) * 0x1p-22f;
  if (distance_squared > reach_squared + doubt) return false;
  if (distance_squared < reach_squared - doubt) return true;
  return overlaps_in_double(a, radius_a, b, radius_b, period);
}

struct ContactGeometry {
  Vec3 normal;  // from the second sphere to the first, unit length
  float depth;  // overlap along the normal, negative where the surfaces are apart [m]
};

// Swapping the two spheres turns the normal round and keeps every other bit: action equals reaction.
FC_HOST_DEVICE inline ContactGeometry contact_geometry(Vec3 a, float radius_a, std::uint32_t id_a, Vec3 b,
                                                       float radius_b, std::uint32_t id_b, Vec3 period) {
  const Vec3 offset = separation(a, b, period);
  const float distance = length(offset);
  const float reach = radius_a + radius_b;
  // Centres that coincide have no direction of their own: the smaller id goes towards +x. The limit keeps the square
  // of the offset in the range of normal numbers.
  const bool is_apart = distance > 1e-18f;
  return {{is_apart      ? offset.x / distance
           : id_a < id_b ? 1.0f
                         : -1.0f,
           is_apart ? offset.y / distance : 0.0f, is_apart ? offset.z / distance : 0.0f},
          is_apart ? reach - distance : reach};
}

}  // namespace fastcollide
