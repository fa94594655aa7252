// Which surface each sample sees: the smallest of (depth, index), kept in one 64-bit word, so that the order in which
// spheres are drawn cannot matter and equal depths go to the smaller index.
#pragma once

#include "tiles.hpp"

namespace fastcollide::render {

inline constexpr std::uint32_t floor_index = 0xFFFFFFFEu;
inline constexpr std::uint32_t nothing_index = 0xFFFFFFFFu;
inline constexpr std::uint64_t sees_nothing = ~std::uint64_t(0);

FC_HOST_DEVICE inline std::uint64_t visibility_key(float depth, std::uint32_t index) {
  return static_cast<std::uint64_t>(bits_of(depth)) << 32 | index;  // depth >= 0: its bits order as it does
}
FC_HOST_DEVICE inline std::uint32_t index_of(std::uint64_t key) { return static_cast<std::uint32_t>(key); }
FC_HOST_DEVICE inline float depth_of(std::uint64_t key) { return float_of(static_cast<std::uint32_t>(key >> 32)); }

// Depth at which the ray meets the floor from above, or no_hit.
FC_HOST_DEVICE inline float floor_depth(const PerspectiveView& view, Vec3 direction, float floor_height) {
  const float above = view.eye.z - floor_height;
  const float fall =
      -(view.axes.right.z * direction.x + view.axes.up.z * direction.y + view.axes.forward.z * direction.z);
  if (!(above > 0.0f && fall * 1e6f > above)) return no_hit;
  const float t = above / fall;
  return t >= view.near ? t : no_hit;
}

// The picture before any sphere: floor or nothing.
struct ClearPicture {
  PerspectiveView view;
  float floor_height;
  std::uint64_t* nearest;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    const float x = static_cast<float>(i % view.width), y = static_cast<float>(i / view.width);
    const float depth = floor_depth(view, view.direction(x, y), floor_height);
    nearest[i] = depth < no_hit ? visibility_key(depth, floor_index) : sees_nothing;
  }
};

struct ClearShadowMap {
  std::uint64_t* nearest;

  FC_HOST_DEVICE void operator()(std::int64_t i) const { nearest[i] = sees_nothing; }
};

template <class View>
struct DrawSpheres {
  View view;
  Tiles tiles;
  const Sphere* spheres;
  std::uint64_t* nearest;

  FC_HOST_DEVICE void operator()(std::int64_t tile) const {
    const std::int64_t owner = tiles.owner(tile);
    const SampleBox box = tiles.samples(tile, owner);
    const Sphere sphere = spheres[owner];
    for (int y = box.y_begin; y < box.y_end; ++y) {
      std::uint64_t* const row = nearest + static_cast<std::int64_t>(y) * view.width;
      // First all depths of the row, a loop of fixed length without branches that compilers turn into vectors.
      float depth[tile_size];
      for (int k = 0; k < tile_size; ++k) depth[k] = view.depth_at(sphere, box.x_begin + k, y);
      for (int k = 0; k < box.x_end - box.x_begin; ++k) {
        if (depth[k] < no_hit) {
          atomic_min(row + box.x_begin + k, visibility_key(depth[k], static_cast<std::uint32_t>(owner)));
        }
      }
    }
  }
};

}  // namespace fastcollide::render
