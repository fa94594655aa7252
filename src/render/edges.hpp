// The twelve edges of the box: thin, smooth lines over the finished picture, hidden where a surface is nearer.
#pragma once

#include "shade.hpp"

namespace fastcollide::render {

// One edge in the picture: from (x, y) with inverse depth to its other end, coordinates in pixels. Inverse depth is
// linear along the line.
struct ProjectedEdge {
  float x, y, inverse_depth;
  float end_x, end_y, end_inverse_depth;
};

// False when the edge lies behind the near plane.
inline bool project_edge(const PerspectiveView& pixels, Vec3 a, Vec3 b, ProjectedEdge& edge) {
  Vec3 p = pixels.into_view(a), q = pixels.into_view(b);
  if (!(p.z > pixels.near || q.z > pixels.near)) return false;
  if (p.z < pixels.near) p = p + (q - p) * ((pixels.near - p.z) / (q.z - p.z));
  if (q.z < pixels.near) q = q + (p - q) * ((pixels.near - q.z) / (p.z - q.z));
  edge = {p.x / p.z / pixels.step + pixels.center_x, pixels.center_y - p.y / p.z / pixels.step, 1.0f / p.z,
          q.x / q.z / pixels.step + pixels.center_x, pixels.center_y - q.y / q.z / pixels.step, 1.0f / q.z};
  return true;
}

// Item i is the i-th pixel along the edge's longer direction.
struct DrawEdge {
  ProjectedEdge edge;
  bool along_x;
  int begin;         // first pixel along
  float half_width;  // pixels
  float strength;
  Vec3 color;  // stored, 0 to 1
  int width, height, supersampling;
  const std::uint64_t* nearest;
  std::uint8_t* rgb;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    const float run_x = edge.end_x - edge.x, run_y = edge.end_y - edge.y;
    const float along = along_x ? run_x : run_y, across = along_x ? run_y : run_x;
    const int major = begin + static_cast<int>(i);
    const float t = (static_cast<float>(major) + 0.5f - (along_x ? edge.x : edge.y)) / along;
    const float minor = (along_x ? edge.y : edge.x) + t * across;
    const float depth =
        1.0f / (edge.inverse_depth + clamp(t, 0.0f, 1.0f) * (edge.end_inverse_depth - edge.inverse_depth));
    const float cosine = larger(along, -along) / square_root(run_x * run_x + run_y * run_y);
    const float end = smaller(t, 1.0f - t) * larger(along, -along);  // pixels before the line ends
    const float ending = clamp(end + 0.5f, 0.0f, 1.0f);
    if (!(minor > -4.0f && minor < static_cast<float>((along_x ? height : width) + 4))) return;
    const int middle = static_cast<int>(minor + 8.0f) - 8;
    for (int offset = -3; offset <= 3; ++offset) {
      const int x = along_x ? major : middle + offset, y = along_x ? middle + offset : major;
      if (x < 0 || y < 0 || x >= width || y >= height) continue;
      const float off = (static_cast<float>(middle + offset) + 0.5f - minor) * cosine;
      const float cover = clamp(half_width + 0.5f - larger(off, -off), 0.0f, smaller(2.0f * half_width, 1.0f));
      if (cover > 0.0f) blend(x, y, cover * ending * strength * seen_share(x, y, depth));
    }
  }

  // Share of the pixel's samples that are not nearer than the line; the floor's own edges lie in the floor.
  FC_HOST_DEVICE float seen_share(int x, int y, float depth) const {
    const std::uint64_t limit = visibility_key(depth * 0.998f, 0);
    const int s = supersampling;
    int seen = 0;
    for (int j = 0; j < s; ++j) {
      for (int i = 0; i < s; ++i) {
        seen += nearest[(static_cast<std::int64_t>(y) * s + j) * (static_cast<std::int64_t>(width) * s) +
                        (static_cast<std::int64_t>(x) * s + i)] >= limit;
      }
    }
    return static_cast<float>(seen) / static_cast<float>(s * s);
  }

  FC_HOST_DEVICE void blend(int x, int y, float share) const {
    std::uint8_t* const pixel = rgb + 3 * (static_cast<std::int64_t>(y) * width + x);
    const float parts[3] = {color.x * 255.0f, color.y * 255.0f, color.z * 255.0f};
    for (int channel = 0; channel < 3; ++channel) {
      const float old = static_cast<float>(pixel[channel]);
      pixel[channel] = static_cast<std::uint8_t>(old + (parts[channel] - old) * share + 0.5f);
    }
  }
};

}  // namespace fastcollide::render
