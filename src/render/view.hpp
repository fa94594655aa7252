// Two ways to look at spheres: the camera's perspective and the light's parallel rays. Each says which samples a sphere
// may touch (footprint) and how far along the ray of a sample its surface lies (depth). The stages that use them are
// templates over the view, so a shadow map is drawn by the very code that draws the picture.
#pragma once

#include "../math.hpp"
#include "picture.hpp"

namespace fastcollide::render {

// Samples [x_begin, x_end) × [y_begin, y_end), inside the picture; empty where an end is not beyond its begin.
struct SampleBox {
  int x_begin, y_begin, x_end, y_end;
};

struct Sphere {
  Vec3 center;  // in the axes of the view: right, up, forward
  float radius;
};

inline constexpr float no_hit = 3.0e38f;

FC_HOST_DEVICE inline Vec3 normalized(Vec3 a) { return a * (1.0f / length(a)); }

// Right, up and forward of something that looks along `forward`. Where `up` is no help (parallel to the line of sight,
// or zero), another axis takes its place.
struct Axes {
  Vec3 right, up, forward;
};
inline Axes axes_looking(Vec3 forward, Vec3 up) {
  forward = normalized(forward);
  Vec3 right = cross(forward, up);
  if (!(length(right) > 1e-4f * length(up))) {
    right = cross(forward, larger(forward.y, -forward.y) < 0.9f ? Vec3{0.0f, 1.0f, 0.0f} : Vec3{1.0f, 0.0f, 0.0f});
  }
  right = normalized(right);
  return {right, cross(right, forward), forward};
}
FC_HOST_DEVICE inline Vec3 turned_into(const Axes& axes, Vec3 a) {
  return {dot(axes.right, a), dot(axes.up, a), dot(axes.forward, a)};
}
FC_HOST_DEVICE inline Vec3 turned_back(const Axes& axes, Vec3 a) {
  return axes.right * a.x + axes.up * a.y + axes.forward * a.z;
}

// The samples whose centres may lie between the real coordinates low and high, with one sample to spare for rounding.
FC_HOST_DEVICE inline void cover(float low, float high, int count, int& begin, int& end) {
  const float limit = static_cast<float>(count);
  begin = static_cast<int>(clamp(low - 1.0f, 0.0f, limit));
  end = static_cast<int>(clamp(high + 2.0f, 0.0f, limit));
}

// Sample (x, y) looks along (slope_x, slope_y, 1) in view axes; depth is the distance along the line of sight, so that
// the point seen is the direction times the depth.
struct PerspectiveView {
  Axes axes;
  Vec3 eye;
  float near;  // surfaces closer than this, and those behind the eye, are cut away
  float step;  // slope from one sample to the next
  float center_x, center_y;
  int width, height;

  FC_HOST_DEVICE float slope_x(float x) const { return (x + 0.5f - center_x) * step; }
  FC_HOST_DEVICE float slope_y(float y) const { return (center_y - (y + 0.5f)) * step; }
  FC_HOST_DEVICE Vec3 direction(float x, float y) const { return {slope_x(x), slope_y(y), 1.0f}; }
  FC_HOST_DEVICE Vec3 into_view(Vec3 position) const { return turned_into(axes, position - eye); }
  FC_HOST_DEVICE Vec3 into_world(Vec3 point) const { return eye + turned_back(axes, point); }

  FC_HOST_DEVICE SampleBox footprint(Sphere s) const {
    const Vec3 c = s.center;
    if (!(c.z + s.radius > near)) return {0, 0, 0, 0};
    // The eye plane cuts the sphere or nearly: its outline is no ellipse, so look everywhere.
    if (!(c.z > s.radius + near)) return {0, 0, width, height};
    SampleBox box;
    float low, high;
    tangent_slopes(c.x, c.z, s.radius, low, high);
    cover(low / step + center_x - 0.5f, high / step + center_x - 0.5f, width, box.x_begin, box.x_end);
    tangent_slopes(c.y, c.z, s.radius, low, high);
    cover(center_y - high / step - 0.5f, center_y - low / step - 0.5f, height, box.y_begin, box.y_end);
    return box;
  }

  // Slopes of the two lines through the eye that touch a circle at (across, ahead), ahead > radius.
  FC_HOST_DEVICE static void tangent_slopes(float across, float ahead, float radius, float& low, float& high) {
    const float middle = across * ahead;
    const float spread = radius * square_root(across * across + (ahead - radius) * (ahead + radius));
    const float scale = 1.0f / ((ahead - radius) * (ahead + radius));
    low = (middle - spread) * scale;
    high = (middle + spread) * scale;
  }

  // Through the foot of the perpendicular from the centre, whose small length keeps its digits far from the eye, where
  // b² − 4ac would lose them.
  FC_HOST_DEVICE float depth(Sphere s, float along_x, float along_y) const {
    const Vec3 c = s.center;
    const float inverse = 1.0f / (along_x * along_x + (along_y * along_y + 1.0f));
    const float foot = (c.x * along_x + (c.y * along_y + c.z)) * inverse;
    const float off_x = c.x - along_x * foot, off_y = c.y - along_y * foot, off_z = c.z - foot;
    const float inside = s.radius * s.radius - (off_x * off_x + off_y * off_y + off_z * off_z);
    const float t = foot - square_root(larger(inside, 0.0f) * inverse);
    return (inside >= 0.0f) & (t >= near) ? t : no_hit;
  }
  FC_HOST_DEVICE float depth_at(Sphere s, int x, int y) const {
    return depth(s, slope_x(static_cast<float>(x)), slope_y(static_cast<float>(y)));
  }
};

// Sample (x, y) looks straight ahead; depth is counted from a plane before the whole box.
struct ParallelView {
  Axes axes;
  Vec3 origin;  // of sample coordinates (0, 0) and depth 0
  float step;   // metres from one sample to the next
  int width, height;

  FC_HOST_DEVICE Vec3 into_view(Vec3 position) const { return turned_into(axes, position - origin); }

  FC_HOST_DEVICE SampleBox footprint(Sphere s) const {
    SampleBox box;
    cover((s.center.x - s.radius) / step - 0.5f, (s.center.x + s.radius) / step - 0.5f, width, box.x_begin, box.x_end);
    cover((s.center.y - s.radius) / step - 0.5f, (s.center.y + s.radius) / step - 0.5f, height, box.y_begin, box.y_end);
    return box;
  }

  FC_HOST_DEVICE float depth_at(Sphere s, int x, int y) const {
    const float off_x = (static_cast<float>(x) + 0.5f) * step - s.center.x;
    const float off_y = (static_cast<float>(y) + 0.5f) * step - s.center.y;
    const float inside = s.radius * s.radius - (off_x * off_x + off_y * off_y);
    const float t = larger(s.center.z - square_root(larger(inside, 0.0f)), 0.0f);
    return inside >= 0.0f ? t : no_hit;
  }
};

// `cell` pixels (or a part of one) become one sample: 0.5 for two samples along a pixel, 2 for one sample in two
// pixels.
inline PerspectiveView perspective_view(const Camera& camera, int width, int height, float cell, int columns,
                                        int rows) {
  PerspectiveView view;
  view.axes = axes_looking(camera.target - camera.eye, camera.up);
  view.eye = camera.eye;
  view.near = 1e-3f * length(camera.target - camera.eye);
  view.step = 2.0f * camera.tan_half_field / static_cast<float>(height) * cell;
  view.center_x = 0.5f * static_cast<float>(width) / cell;
  view.center_y = 0.5f * static_cast<float>(height) / cell;
  view.width = columns;
  view.height = rows;
  return view;
}

// Square map of `size` samples that holds all light that passes through the box.
inline ParallelView parallel_view(const Light& light, Vec3 lower, Vec3 upper, int size) {
  ParallelView view;
  view.axes = axes_looking(light.towards * -1.0f, Vec3{0.0f, 0.0f, 1.0f});
  Vec3 low{no_hit, no_hit, no_hit}, high{-no_hit, -no_hit, -no_hit};
  for (int corner = 0; corner < 8; ++corner) {
    const Vec3 p = turned_into(
        view.axes, {corner & 1 ? upper.x : lower.x, corner & 2 ? upper.y : lower.y, corner & 4 ? upper.z : lower.z});
    low = {smaller(low.x, p.x), smaller(low.y, p.y), smaller(low.z, p.z)};
    high = {larger(high.x, p.x), larger(high.y, p.y), larger(high.z, p.z)};
  }
  const float extent = larger(high.x - low.x, high.y - low.y);
  view.step = extent / static_cast<float>(size - 8);
  const float margin = 4.0f * view.step;  // so that a soft edge at the border finds light, not the map's end
  view.origin = turned_back(view.axes, {low.x - margin, low.y - margin, low.z - extent});
  view.width = view.height = size;
  return view;
}

}  // namespace fastcollide::render
