// Work in equal pieces. A sphere's footprint may be one sample or the whole picture, so it is cut into tiles; the tiles
// of all spheres are numbered one after the other and for_each runs over tiles. No thread, on any device, gets more
// than one tile at a time.
#pragma once

#include "view.hpp"

namespace fastcollide::render {

inline constexpr int tile_size = 16;

FC_HOST_DEVICE inline int tiles_along(int begin, int end) {
  return end > begin ? (end - begin + tile_size - 1) / tile_size : 0;
}

// Places each sphere in the view and counts the tiles that a sphere `reach` times as large would touch.
template <class View>
struct PlaceSpheres {
  View view;
  float reach;
  const float* positions;
  const float* radii;
  Sphere* spheres;
  SampleBox* boxes;
  std::int64_t* tile_count;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    const Vec3 position{positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]};
    const float radius = radii[i];
    const Sphere sphere{view.into_view(position), radius};
    spheres[i] = sphere;
    SampleBox box{0, 0, 0, 0};
    if (is_finite(sphere.center) && is_finite(radius) && radius > 0.0f) {
      box = view.footprint({sphere.center, radius * reach});
    }
    boxes[i] = box;
    tile_count[i] =
        static_cast<std::int64_t>(tiles_along(box.x_begin, box.x_end)) * tiles_along(box.y_begin, box.y_end);
  }
};

// The numbered tiles of n spheres.
struct Tiles {
  std::int64_t n;
  const std::int64_t* tile_start;  // n + 1 entries, ascending
  const SampleBox* boxes;

  // The sphere that owns the tile: the last one that starts at or before it.
  FC_HOST_DEVICE std::int64_t owner(std::int64_t tile) const {
    std::int64_t low = 0, high = n;
    while (high - low > 1) {
      const std::int64_t middle = (low + high) / 2;
      if (tile_start[middle] <= tile) {
        low = middle;
      } else {
        high = middle;
      }
    }
    return low;
  }

  FC_HOST_DEVICE SampleBox samples(std::int64_t tile, std::int64_t owner) const {
    const SampleBox box = boxes[owner];
    const int number = static_cast<int>(tile - tile_start[owner]);
    const int columns = tiles_along(box.x_begin, box.x_end);
    const int x = box.x_begin + number % columns * tile_size;
    const int y = box.y_begin + number / columns * tile_size;
    return {x, y, x + tile_size < box.x_end ? x + tile_size : box.x_end,
            y + tile_size < box.y_end ? y + tile_size : box.y_end};
  }
};

}  // namespace fastcollide::render
