// The box and what happens at its ends.
#pragma once

#include "../math.hpp"
#include "fastcollide/boundary.hpp"

namespace fastcollide {

struct Box {
  Vec3 lower, upper;  // [m]; an open axis does not look at them
  Boundary x, y, z;
};

// Lengths of the periodic axes [m], 0 for the others.
FC_HOST_DEVICE inline Vec3 period_of(const Box& box) {
  return {box.x == Boundary::periodic ? box.upper.x - box.lower.x : 0.0f,
          box.y == Boundary::periodic ? box.upper.y - box.lower.y : 0.0f,
          box.z == Boundary::periodic ? box.upper.z - box.lower.z : 0.0f};
}

// The difference of two coordinates, to the nearest image along a periodic axis.
template <class Number>
FC_HOST_DEVICE inline Number nearest_image(Number difference, float period) {
  if (period > 0.0f) {
    const Number length = static_cast<Number>(period), half = length * static_cast<Number>(0.5);
    if (difference > half) return difference - length;
    if (difference < -half) return difference + length;
  }
  return difference;
}

FC_HOST_DEVICE inline Vec3 separation(Vec3 a, Vec3 b, Vec3 period) {
  return {nearest_image(a.x - b.x, period.x), nearest_image(a.y - b.y, period.y), nearest_image(a.z - b.z, period.z)};
}

// Puts a coordinate that left a periodic axis back into [lower, upper).
FC_HOST_DEVICE inline float wrap(float x, float lower, float upper) {
  if (x >= lower && x < upper) return x;
  const float length = upper - lower;
  const float wrapped = x - length * floorf((x - lower) / length);
  return wrapped >= lower && wrapped < upper ? wrapped : lower;
}

// A position that may be outside the walls, in the first image of each periodic axis.
FC_HOST_DEVICE inline float wrap_on_axis(float x, float lower, float upper, Boundary boundary) {
  return boundary == Boundary::periodic ? wrap(x, lower, upper) : x;
}

FC_HOST_DEVICE inline Vec3 first_image(Vec3 position, const Box& box) {
  return {wrap_on_axis(position.x, box.lower.x, box.upper.x, box.x),
          wrap_on_axis(position.y, box.lower.y, box.upper.y, box.y),
          wrap_on_axis(position.z, box.lower.z, box.upper.z, box.z)};
}

// Where a position may be: inside the walls by a radius, in the first image of a periodic axis, anywhere along an open
// axis.
FC_HOST_DEVICE inline float keep_on_axis(float x, float radius, float lower, float upper, Boundary boundary) {
  return boundary == Boundary::wall ? clamp(x, lower + radius, upper - radius)
                                    : wrap_on_axis(x, lower, upper, boundary);
}

FC_HOST_DEVICE inline Vec3 keep_inside(Vec3 position, float radius, const Box& box) {
  return {keep_on_axis(position.x, radius, box.lower.x, box.upper.x, box.x),
          keep_on_axis(position.y, radius, box.lower.y, box.upper.y, box.y),
          keep_on_axis(position.z, radius, box.lower.z, box.upper.z, box.z)};
}

// Along an open axis float32 still has to place a sphere to 1/64 of its radius.
inline constexpr float reach_in_radii = 131072.0f;  // 2^17

FC_HOST_DEVICE inline bool is_in_reach(Vec3 position, float radius, const Box& box) {
  const float reach = reach_in_radii * radius;
  return (box.x != Boundary::open || fabsf(position.x) <= reach) &&
         (box.y != Boundary::open || fabsf(position.y) <= reach) &&
         (box.z != Boundary::open || fabsf(position.z) <= reach);
}

}  // namespace fastcollide
