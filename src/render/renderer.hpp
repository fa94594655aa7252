// Spheres to a picture, stage by stage, on any backend. The bytes are the same on the CPU with any number of threads
// and on CUDA: minima and integer sums in place of order, and only correctly rounded arithmetic (math.hpp).
#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>

#include "../backend/concept.hpp"
#include "edges.hpp"

namespace fastcollide::render {

// Keeps its buffers from picture to picture.
template <class B>
  requires Backend<B>
class Renderer {
 public:
  explicit Renderer(B& backend) : backend_(backend) {}

  // positions [m] n × 3 packed, radii [m] n and values n lie on the device; rgb height × width × 3 on the host.
  // A sphere with a radius or place that is not finite, or a radius of zero or less, is not drawn; of a sphere around
  // the eye or behind it only the part before the near plane (a thousandth of the way to the target) is.
  void draw(const PictureOptions& options, const Camera& camera, std::int64_t n, const float* positions,
            const float* radii, const float* values, std::uint8_t* rgb_host) {
    const int s = options.supersampling;
    const int cell_columns = (options.width + occlusion_cell - 1) / occlusion_cell;
    const int cell_rows = (options.height + occlusion_cell - 1) / occlusion_cell;
    const PerspectiveView samples =
        perspective_view(camera, options.width, options.height, 1.0f / s, options.width * s, options.height * s);
    const PerspectiveView cells =
        perspective_view(camera, options.width, options.height, occlusion_cell, cell_columns, cell_rows);
    const ParallelView light = parallel_view(options.light, options.lower, options.upper, shadow_map_size);

    nearest_to_light_.resize(std::int64_t(light.width) * light.height);
    backend_.for_each(nearest_to_light_.size(), ClearShadowMap{nearest_to_light_.data()});
    std::int64_t tiles = place(light, 1.0f, n, positions, radii);
    backend_.for_each(tiles, DrawSpheres<ParallelView>{light, numbered(n), spheres_.data(), nearest_to_light_.data()});

    nearest_.resize(std::int64_t(samples.width) * samples.height);
    backend_.for_each(nearest_.size(), ClearPicture{samples, options.lower.z, nearest_.data()});
    tiles = place(samples, 1.0f, n, positions, radii);
    backend_.for_each(tiles, DrawSpheres<PerspectiveView>{samples, numbered(n), spheres_.data(), nearest_.data()});

    occlusion_.resize(std::int64_t(cell_columns) * cell_rows);
    tiles = place(cells, occlusion_reach, n, positions, radii);
    backend_.for_each(occlusion_.size(),
                      ClearOcclusion{samples, cells, occlusion_cell * s, turned_into(samples.axes, {0.0f, 0.0f, 1.0f}),
                                     spheres_.data(), nearest_.data(), occlusion_.data()});
    backend_.for_each(tiles, AddOcclusion{cells, numbered(n), spheres_.data(), occlusion_.data()});

    const std::int64_t pixels = std::int64_t(options.width) * options.height;
    color_table_.resize(sizeof options.color_table);
    backend_.copy_to_device(color_table_.data(), &options.color_table[0][0], color_table_.size());
    rgb_.resize(3 * pixels);
    shade(options, scene(options, camera, samples, light, positions, radii, values));
    draw_edges(options, camera);
    backend_.copy_to_host(rgb_host, rgb_.data(), 3 * pixels);
    backend_.synchronize();
  }

 private:
  static constexpr int shadow_map_size = 1024;

  template <class View>
  std::int64_t place(const View& view, float reach, std::int64_t n, const float* positions, const float* radii) {
    spheres_.resize(n);
    boxes_.resize(n);
    tile_start_.resize(n + 1);
    if (n == 0) return 0;
    backend_.for_each(
        n, PlaceSpheres<View>{view, reach, positions, radii, spheres_.data(), boxes_.data(), tile_start_.data()});
    backend_.exclusive_scan(tile_start_.data(), n);
    std::int64_t tiles = 0;
    backend_.copy_to_host(&tiles, static_cast<const std::int64_t*>(tile_start_.data() + n), 1);
    backend_.synchronize();
    return tiles;
  }
  Tiles numbered(std::int64_t n) { return {n, tile_start_.data(), boxes_.data()}; }

  Scene scene(const PictureOptions& options, const Camera& camera, const PerspectiveView& samples,
              const ParallelView& light, const float* positions, const float* radii, const float* values) {
    Scene scene;
    scene.view = samples;
    scene.pixel_step = samples.step * static_cast<float>(options.supersampling);
    scene.light = light;
    scene.towards_light = normalized(options.light.towards);
    scene.lower = options.lower;
    scene.upper = options.upper;
    const Vec3 size = options.upper - options.lower;
    scene.grid_spacing = round_length(larger(size.x, size.y) / 10.0f);
    const float reach = 0.5f * length(size);
    scene.fade_begin = 0.8f * reach;
    scene.fade_end = 2.6f * reach;
    const float away = length((options.lower + options.upper) * 0.5f - camera.eye);
    scene.haze_begin = larger(away - reach, 0.0f);
    scene.haze_end = away + reach;
    scene.value_low = options.value_low;
    const float range = options.value_high - options.value_low;
    scene.value_scale = range > 0.0f ? 255.0f / range : 0.0f;
    scene.positions = positions;
    scene.radii = radii;
    scene.values = values;
    scene.color_table = color_table_.data();
    scene.nearest_to_light = nearest_to_light_.data();
    scene.occlusion = occlusion_.data();
    scene.occlusion_columns = (options.width + occlusion_cell - 1) / occlusion_cell;
    scene.occlusion_rows = (options.height + occlusion_cell - 1) / occlusion_cell;
    return scene;
  }

  void shade(const PictureOptions& options, const Scene& scene) {
    ShadePixels stage;
    stage.scene = scene;
    stage.nearest = nearest_.data();
    stage.width = options.width;
    stage.height = options.height;
    stage.supersampling = options.supersampling;
    stage.bands = (options.height + ShadePixels::band_rows - 1) / ShadePixels::band_rows;
    stage.band_stride = std::max(1, stage.bands * 5 / 8);
    while (std::gcd(stage.band_stride, stage.bands) != 1) ++stage.band_stride;
    stage.rgb = rgb_.data();
    backend_.for_each(std::int64_t(stage.bands) * ShadePixels::band_rows * options.width, stage);
  }

  void draw_edges(const PictureOptions& options, const Camera& camera) {
    const PerspectiveView pixels =
        perspective_view(camera, options.width, options.height, 1.0f, options.width, options.height);
    for (int number = 0; number < 12; ++number) {
      const int axis = number / 4;
      const int first = (axis + 1) % 3, second = (axis + 2) % 3;
      const int begin = (number & 1) << first | (number >> 1 & 1) << second;
      ProjectedEdge edge;
      if (!project_edge(pixels, corner(options, begin), corner(options, begin | 1 << axis), edge)) continue;
      const float run_x = edge.end_x - edge.x, run_y = edge.end_y - edge.y;
      const bool along_x = run_x * run_x >= run_y * run_y;
      const float from = along_x ? smaller(edge.x, edge.end_x) : smaller(edge.y, edge.end_y);
      const float to = along_x ? larger(edge.x, edge.end_x) : larger(edge.y, edge.end_y);
      const float limit = static_cast<float>(along_x ? options.width : options.height);
      const int low = static_cast<int>(clamp(from - 1.0f, 0.0f, limit));
      const int high = static_cast<int>(clamp(to + 2.0f, 0.0f, limit));
      if (high <= low || !(to > from)) continue;
      const float half_width = 0.5f * larger(1.0f, static_cast<float>(options.height) / 640.0f);
      const Palette look;
      backend_.for_each(high - low,
                        DrawEdge{edge, along_x, low, half_width, look.line_strength, look.line, options.width,
                                 options.height, options.supersampling, nearest_.data(), rgb_.data()});
    }
  }

  static Vec3 corner(const PictureOptions& options, int bits) {
    return {bits & 1 ? options.upper.x : options.lower.x, bits & 2 ? options.upper.y : options.lower.y,
            bits & 4 ? options.upper.z : options.lower.z};
  }

  // The largest of 1, 2, 5 times a power of ten that is not above x.
  static float round_length(float x) {
    const float power = std::pow(10.0f, std::floor(std::log10(x)));
    return x >= 5.0f * power ? 5.0f * power : x >= 2.0f * power ? 2.0f * power : power;
  }

  B& backend_;
  typename B::template Buffer<Sphere> spheres_{backend_};
  typename B::template Buffer<SampleBox> boxes_{backend_};
  typename B::template Buffer<std::int64_t> tile_start_{backend_};
  typename B::template Buffer<std::uint64_t> nearest_{backend_}, nearest_to_light_{backend_};
  typename B::template Buffer<OcclusionCell> occlusion_{backend_};
  typename B::template Buffer<std::uint8_t> color_table_{backend_}, rgb_{backend_};
};

}  // namespace fastcollide::render
