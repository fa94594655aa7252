// Ambient occlusion: how much of the sky the spheres around a point hide from it. Not guessed from the depth buffer but
// summed from the spheres themselves in closed form, so it is smooth in space and in time and a film of it does not
// flicker. Each sphere darkens the cells of the picture within its reach; a cell is the surface seen at the middle of
// cell_size × cell_size pixels. The sums are integers: order-free.
#pragma once

#include "visibility.hpp"

namespace fastcollide::render {

inline constexpr int occlusion_cell = 2;              // pixels
inline constexpr float occlusion_reach = 2.5f;        // radii from a sphere's centre within which it darkens
inline constexpr float occlusion_unit = 1.0f / 4096;  // one count of a sum

// Adds to *target, from any thread at once; integers, so the order is of no account.
FC_HOST_DEVICE inline void atomic_add(std::uint32_t* target, std::uint32_t value) {
#if defined(__CUDA_ARCH__)
  atomicAdd(target, value);
#elif !defined(__CUDACC__)
  std::atomic_ref<std::uint32_t>(*target).fetch_add(value, std::memory_order_relaxed);
#else
  *target += value;  // host pass of nvcc: compiled, never run
#endif
}

// What a cell sees, in view axes.
struct OcclusionCell {
  Vec3 point;
  std::uint32_t index;  // sphere, floor_index or nothing_index
  Vec3 normal;
  std::uint32_t hidden;  // sum, in occlusion_unit
};

struct ClearOcclusion {
  PerspectiveView samples, cells;
  int cell_samples;   // along each axis
  Vec3 floor_normal;  // in view axes
  const Sphere* spheres;
  const std::uint64_t* nearest;
  OcclusionCell* seen;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    int x = static_cast<int>(i % cells.width) * cell_samples + cell_samples / 2;
    int y = static_cast<int>(i / cells.width) * cell_samples + cell_samples / 2;
    if (x >= samples.width) x = samples.width - 1;
    if (y >= samples.height) y = samples.height - 1;
    const std::uint64_t key = nearest[static_cast<std::int64_t>(y) * samples.width + x];
    OcclusionCell cell{{0.0f, 0.0f, 0.0f}, index_of(key), floor_normal, 0};
    if (cell.index != nothing_index) {
      cell.point = samples.direction(static_cast<float>(x), static_cast<float>(y)) * depth_of(key);
      if (cell.index != floor_index) {
        const Sphere sphere = spheres[cell.index];
        cell.normal = (cell.point - sphere.center) * (1.0f / sphere.radius);
      }
    }
    seen[i] = cell;
  }
};

// Share of the cosine-weighted hemisphere over the point that the sphere hides, fading to nothing at its reach.
// Above the horizon cos·r²/d² is exact; a sphere that the horizon cuts goes to zero smoothly.
FC_HOST_DEVICE inline float hidden_share(Vec3 point, Vec3 normal, Sphere sphere) {
  const Vec3 to_center = sphere.center - point;
  const float squared = dot(to_center, to_center);
  const float radius_squared = sphere.radius * sphere.radius;
  const float inside = 1.0f - squared / (radius_squared * (occlusion_reach * occlusion_reach));
  if (!(inside > 0.0f)) return 0.0f;
  const float height = dot(normal, to_center) / sphere.radius;  // over the horizon, in radii
  if (!(height > -1.0f)) return 0.0f;
  const float rise = height >= 1.0f ? height : 0.25f * (height + 1.0f) * (height + 1.0f);
  const float near = smaller(radius_squared / larger(squared, 1e-30f), 1.0f);  // (r/d)²
  return smaller(rise * near * square_root(near), 1.0f) * inside * inside;
}

struct AddOcclusion {
  PerspectiveView cells;
  Tiles tiles;
  const Sphere* spheres;
  OcclusionCell* seen;

  FC_HOST_DEVICE void operator()(std::int64_t tile) const {
    const std::int64_t owner = tiles.owner(tile);
    const SampleBox box = tiles.samples(tile, owner);
    const Sphere sphere = spheres[owner];
    const float reach = sphere.radius * occlusion_reach;
    for (int y = box.y_begin; y < box.y_end; ++y) {
      OcclusionCell* const row = seen + static_cast<std::int64_t>(y) * cells.width;
      for (int x = box.x_begin; x < box.x_end; ++x) {
        const OcclusionCell& cell = row[x];
        const float ahead = sphere.center.z - cell.point.z;
        if (!(ahead < reach && ahead > -reach)) continue;
        if (cell.index == static_cast<std::uint32_t>(owner) || cell.index == nothing_index) continue;
        const float share = hidden_share(cell.point, cell.normal, sphere);
        if (share > 0.0f) atomic_add(&row[x].hidden, static_cast<std::uint32_t>(share / occlusion_unit + 0.5f));
      }
    }
  }
};

// Sum for a surface at the real pixel coordinates (x, y): between the four nearest cells that see the same surface, or,
// if none does, of the nearest cell.
FC_HOST_DEVICE inline float hidden_at(const OcclusionCell* seen, int columns, int rows, float x, float y,
                                      std::uint32_t index) {
  const float u = clamp(x / occlusion_cell - 0.5f, 0.0f, static_cast<float>(columns - 1));
  const float v = clamp(y / occlusion_cell - 0.5f, 0.0f, static_cast<float>(rows - 1));
  const int column = static_cast<int>(u), row = static_cast<int>(v);
  const float right = u - static_cast<float>(column), down = v - static_cast<float>(row);
  float sum = 0.0f, weights = 0.0f;
  for (int corner = 0; corner < 4; ++corner) {
    const int c = column + (corner & 1), r = row + (corner >> 1);
    if (c >= columns || r >= rows) continue;
    const OcclusionCell& cell = seen[static_cast<std::int64_t>(r) * columns + c];
    if (cell.index != index) continue;
    const float weight = (corner & 1 ? right : 1.0f - right) * (corner >> 1 ? down : 1.0f - down) + 1e-4f;
    sum += weight * static_cast<float>(cell.hidden);
    weights += weight;
  }
  if (!(weights > 0.0f)) {
    const int c = column + (right > 0.5f && column + 1 < columns), r = row + (down > 0.5f && row + 1 < rows);
    return static_cast<float>(seen[static_cast<std::int64_t>(r) * columns + c].hidden) * occlusion_unit;
  }
  return sum / weights * occlusion_unit;
}

}  // namespace fastcollide::render
