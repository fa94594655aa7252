// From surfaces to colours. Light is linear in here; a stored colour is its square root (gamma 2, near enough to sRGB
// and exact on every device).
#pragma once

#include "occlusion.hpp"

namespace fastcollide::render {

FC_HOST_DEVICE inline float linear_light(float stored) { return stored * stored; }
FC_HOST_DEVICE inline Vec3 linear_light(Vec3 stored) {
  return {stored.x * stored.x, stored.y * stored.y, stored.z * stored.z};
}
FC_HOST_DEVICE inline Vec3 times(Vec3 a, Vec3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
FC_HOST_DEVICE inline Vec3 mixed(Vec3 a, Vec3 b, float share) { return a + (b - a) * share; }
FC_HOST_DEVICE inline float smooth(float low, float high, float x) {
  const float t = clamp((x - low) / (high - low), 0.0f, 1.0f);
  return t * t * (3.0f - 2.0f * t);
}

// The look, in one place. Colours are stored values, 0 to 1.
struct Palette {
  Vec3 horizon{0.945f, 0.951f, 0.960f};
  Vec3 zenith{0.790f, 0.835f, 0.885f};
  Vec3 floor{0.925f, 0.931f, 0.940f};
  Vec3 line{0.36f, 0.41f, 0.48f};  // of the box's edges
  float line_strength = 0.55f;
  Vec3 sun{1.00f, 0.97f, 0.92f};
  float sun_strength = 1.22f;
  Vec3 sky{0.93f, 0.97f, 1.00f};
  float sky_strength = 0.78f;
  Vec3 bounce{0.98f, 0.96f, 0.94f};
  float bounce_strength = 0.32f;
  float highlight = 0.32f;
  float occlusion = 1.3f;         // strength on spheres
  float floor_sun_share = 0.30f;  // how much of the floor's brightness a shadow takes
  float grid_strength = 0.22f;
  float haze = 0.10f;  // of the horizon's colour at the far end of the box
};

// All that a pixel needs to know, in world axes unless said otherwise.
struct Scene {
  PerspectiveView view;  // of samples
  float pixel_step;      // slope from one pixel to the next
  ParallelView light;
  Vec3 towards_light;
  Vec3 lower, upper;
  float grid_spacing;          // of the floor, m
  float fade_begin, fade_end;  // distance from the middle of the floor over which it becomes the horizon
  float haze_begin, haze_end;  // depth
  float value_low, value_scale;
  Palette palette;
  const float* positions;
  const float* radii;
  const float* values;
  const std::uint8_t* color_table;
  const std::uint64_t* nearest_to_light;
  const OcclusionCell* occlusion;
  int occlusion_columns, occlusion_rows;
};

// Share of the light that reaches a point: the shadow map filtered over 4 × 4 samples. The sphere `own` never shades
// itself here (its dark side is the cosine's work), so no bias is needed against its own roundness.
FC_HOST_DEVICE inline float light_reaching(const Scene& scene, Vec3 point, Vec3 normal, std::uint32_t own) {
  const ParallelView& light = scene.light;
  const Vec3 p = light.into_view(point + normal * light.step);
  const float u = p.x / light.step - 1.5f, v = p.y / light.step - 1.5f;
  const float last = static_cast<float>(light.width - 4);
  if (!(u >= 0.0f && v >= 0.0f && u < last && v < last)) return 1.0f;
  const int column = static_cast<int>(u), row = static_cast<int>(v);
  const float right = u - static_cast<float>(column), down = v - static_cast<float>(row);
  const std::uint64_t limit = visibility_key(larger(p.z - light.step, 0.0f), 0);
  float lit = 0.0f;
  for (int y = 0; y < 4; ++y) {
    const std::uint64_t* const keys =
        scene.nearest_to_light + static_cast<std::int64_t>(row + y) * light.width + column;
    float across = 0.0f;
    for (int x = 0; x < 4; ++x) {
      const float weight = x == 0 ? 1.0f - right : x == 3 ? right : 1.0f;
      across += keys[x] >= limit || index_of(keys[x]) == own ? weight : 0.0f;
    }
    lit += across * (y == 0 ? 1.0f - down : y == 3 ? down : 1.0f);
  }
  return lit * (1.0f / 9.0f);
}

FC_HOST_DEVICE inline Vec3 table_color(const Scene& scene, float value) {
  const float place = clamp((value - scene.value_low) * scene.value_scale, 0.0f, 255.0f);
  const std::uint8_t* const rgb = scene.color_table + 3 * static_cast<int>(place + 0.5f);
  return Vec3{static_cast<float>(rgb[0]), static_cast<float>(rgb[1]), static_cast<float>(rgb[2])} * (1.0f / 255.0f);
}

// From the horizon up: brighter below, calmer above.
FC_HOST_DEVICE inline Vec3 background(const Scene& scene, Vec3 towards) {
  const float rise = clamp(towards.z, 0.0f, 1.0f);
  return linear_light(mixed(scene.palette.horizon, scene.palette.zenith, smooth(0.0f, 0.75f, rise)));
}

// Share of a footprint `width` wide around x that lies on lines of the given half width, spaced evenly.
FC_HOST_DEVICE inline float grid_cover(float x, float spacing, float half_width, float width) {
  const float turns = x / spacing;
  const float nearest = static_cast<float>(static_cast<int>(turns + (turns < 0.0f ? -0.5f : 0.5f)));
  const float off = larger((turns - nearest) * spacing, (nearest - turns) * spacing);
  const float covered = clamp((half_width + 0.5f * width - off) / width, 0.0f, 1.0f);
  return smaller(covered, 2.0f * half_width / width);
}

FC_HOST_DEVICE inline Vec3 floor_color(const Scene& scene, Vec3 point, Vec3 towards_eye, float depth, float hidden) {
  const Palette& look = scene.palette;
  const Vec3 middle = (scene.lower + scene.upper) * 0.5f;
  const float away_x = point.x - middle.x, away_y = point.y - middle.y;
  const float fade = smooth(scene.fade_begin, scene.fade_end, square_root(away_x * away_x + away_y * away_y));
  const Vec3 far = linear_light(look.horizon);
  if (!(fade < 1.0f)) return far;
  const float lit = light_reaching(scene, point, {0.0f, 0.0f, 1.0f}, floor_index);
  const float open = 1.0f / (1.0f + look.occlusion * hidden);
  Vec3 color = linear_light(look.floor);
  // The shadow is lit by the sky and so a little blue.
  const Vec3 in_shadow = times(color, linear_light(look.sky)) * (1.0f - look.floor_sun_share);
  color = mixed(in_shadow, color, lit) * open;
  const float inside = smaller(smaller(point.x - scene.lower.x, scene.upper.x - point.x),
                               smaller(point.y - scene.lower.y, scene.upper.y - point.y));
  if (inside > 0.0f) {
    const float slant = depth * scene.pixel_step / larger(towards_eye.z, 0.05f);
    const float half_width = 0.008f * scene.grid_spacing;
    const float x = grid_cover(point.x - middle.x, scene.grid_spacing, half_width, slant);
    const float y = grid_cover(point.y - middle.y, scene.grid_spacing, half_width, slant);
    color = color * (1.0f - look.grid_strength * larger(x, y));
  }
  return mixed(color, far, fade);
}

FC_HOST_DEVICE inline Vec3 sphere_color(const Scene& scene, Vec3 albedo, Vec3 point, Vec3 normal, Vec3 towards_eye,
                                        float depth, float hidden, std::uint32_t index) {
  const Palette& look = scene.palette;
  const float facing = dot(normal, scene.towards_light);
  const float lit = facing > 0.0f ? light_reaching(scene, point, normal, index) : 0.0f;
  const float open = 1.0f / (1.0f + look.occlusion * hidden);
  const float upward = 0.5f + 0.5f * normal.z;
  const float towards = clamp(dot(normal, towards_eye), 0.0f, 1.0f);
  // Less at the rim: spheres in the shadow of others stay round, too.
  const Vec3 ambient =
      mixed(linear_light(look.bounce) * look.bounce_strength, linear_light(look.sky) * look.sky_strength, upward) *
      (open * (0.62f + 0.38f * towards));
  const Vec3 sun = linear_light(look.sun) * look.sun_strength;
  Vec3 color = times(albedo, ambient + sun * (larger(facing, 0.0f) * lit));

  const Vec3 half = normalized(towards_eye + scene.towards_light);
  float shine = larger(dot(half, normal), 0.0f);
  for (int squaring = 0; squaring < 5; ++squaring) shine = shine * shine;  // to the 32nd power
  color = color + sun * (look.highlight * shine * lit);

  const float grazing = 1.0f - towards;
  const float squared = grazing * grazing;
  const float fresnel = 0.04f + 0.50f * squared * squared * grazing;  // Schlick 1994, eq. 15, weakened
  color = color + ambient * (fresnel * upward);

  return mixed(color, linear_light(look.horizon), look.haze * smooth(scene.haze_begin, scene.haze_end, depth));
}

// One pixel: shades each surface that its samples see once, at the middle of the samples that see it, and adds them by
// their number. As sharp as shading each sample where it matters, at the edges, for a fraction of the work.
struct ShadePixels {
  Scene scene;
  int width, height, supersampling;
  int bands, band_stride;  // see row_of
  const std::uint64_t* nearest;
  std::uint8_t* rgb;

  static constexpr int band_rows = 8;
  static constexpr int most_samples = 16;  // in a pixel

  // Threads get equal, contiguous runs of items, but spheres lie at the bottom of the picture and the sky is cheap:
  // bands of rows are dealt out in an order in which every run of them is spread over the whole picture.
  FC_HOST_DEVICE int row_of(std::int64_t item) const {
    const std::int64_t band = item / (static_cast<std::int64_t>(band_rows) * width);
    return static_cast<int>(band * band_stride % bands) * band_rows + static_cast<int>(item / width % band_rows);
  }

  FC_HOST_DEVICE void operator()(std::int64_t item) const {
    const int x = static_cast<int>(item % width), y = row_of(item);
    if (y >= height) return;
    const int s = supersampling;
    std::uint64_t keys[most_samples];
    for (int j = 0; j < s; ++j) {
      for (int i = 0; i < s; ++i) {
        keys[j * s + i] = nearest[(static_cast<std::int64_t>(y) * s + j) * scene.view.width + (x * s + i)];
      }
    }
    Vec3 color{0.0f, 0.0f, 0.0f};
    unsigned done = 0;
    for (int first = 0; first < s * s; ++first) {
      if (done >> first & 1u) continue;
      const std::uint32_t index = index_of(keys[first]);
      int count = 0, sum_x = 0, sum_y = 0;
      for (int k = first; k < s * s; ++k) {
        if (index_of(keys[k]) != index) continue;
        done |= 1u << k;
        ++count;
        sum_x += k % s;
        sum_y += k / s;
      }
      const float share = 1.0f / static_cast<float>(count);
      const Vec3 seen = shade(index, static_cast<float>(x * s) + static_cast<float>(sum_x) * share,
                              static_cast<float>(y * s) + static_cast<float>(sum_y) * share);
      color =
          color + Vec3{smaller(seen.x, 1.0f), smaller(seen.y, 1.0f), smaller(seen.z, 1.0f)} * static_cast<float>(count);
    }
    const float share = 1.0f / static_cast<float>(s * s);
    std::uint8_t* const pixel = rgb + 3 * (static_cast<std::int64_t>(y) * width + x);
    const float rounding = rounding_at(x, y);
    pixel[0] = stored(color.x * share, rounding);
    pixel[1] = stored(color.y * share, rounding);
    pixel[2] = stored(color.z * share, rounding);
  }

  FC_HOST_DEVICE static std::uint8_t stored(float light, float rounding) {
    return static_cast<std::uint8_t>(square_root(clamp(light, 0.0f, 1.0f)) * 255.0f + rounding);
  }

  // Rounds up at another part in each pixel of a 4 × 4 square (Bayer 1973): the soft gradients show no steps.
  FC_HOST_DEVICE static float rounding_at(int x, int y) {
    const int a = x ^ y;
    const int rank = (a & 1) << 3 | (x & 1) << 2 | (a & 2) | (x & 2) >> 1;
    return (static_cast<float>(rank) + 0.5f) * (1.0f / 16.0f);
  }

  FC_HOST_DEVICE Vec3 shade(std::uint32_t index, float x, float y) const {
    const PerspectiveView& view = scene.view;
    const Vec3 along = view.direction(x, y);
    const Vec3 ray = turned_back(view.axes, along);
    const Vec3 towards_eye = normalized(ray) * -1.0f;
    if (index == nothing_index) return background(scene, towards_eye * -1.0f);

    const float per_sample = 1.0f / static_cast<float>(supersampling);
    const float hidden = hidden_at(scene.occlusion, scene.occlusion_columns, scene.occlusion_rows,
                                   (x + 0.5f) * per_sample, (y + 0.5f) * per_sample, index);
    if (index == floor_index) {
      const float depth = floor_depth(view, along, scene.lower.z);
      if (!(depth < no_hit)) return linear_light(scene.palette.horizon);
      return floor_color(scene, view.eye + ray * depth, towards_eye, depth, hidden);
    }
    const Vec3 center{scene.positions[3 * std::int64_t(index)], scene.positions[3 * std::int64_t(index) + 1],
                      scene.positions[3 * std::int64_t(index) + 2]};
    const Sphere sphere{center - view.eye, scene.radii[index]};
    // The ray through the middle of its samples meets the sphere, but for rounding at its rim: there, the rim.
    const float inverse = 1.0f / dot(ray, ray);
    const float foot = dot(sphere.center, ray) * inverse;
    const Vec3 off = sphere.center - ray * foot;
    const float inside = larger(sphere.radius * sphere.radius - dot(off, off), 0.0f);
    const float depth = foot - square_root(inside * inverse);
    const Vec3 from_eye = ray * depth;
    const Vec3 normal = normalized(from_eye - sphere.center);
    const Vec3 albedo = linear_light(table_color(scene, scene.values[index]));
    return sphere_color(scene, albedo, view.eye + from_eye, normal, towards_eye, depth, hidden, index);
  }
};

}  // namespace fastcollide::render
