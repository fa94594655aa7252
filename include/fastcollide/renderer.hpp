// Pictures of spheres, ray-cast on any device: no display, no graphics library.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace fastcollide {

struct Picture {
  int width = 1280, height = 720;  // [pixels]
  int supersampling = 2;           // rays along each side of a pixel, 1 ... 4
  std::array<float, 3> eye{}, target{}, up{0, 0, 1};
  float tan_half_field = 0.4f;                      // of the vertical field of view
  std::array<float, 3> box_lower{}, box_upper{};    // drawn as floor and edges [m]
  std::array<std::uint8_t, 256 * 3> color_table{};  // RGB
  float value_low = 0, value_high = 1;              // values at the ends of the table
};

class RendererEngine;

class Renderer {
 public:
  // Errors: DeviceError.
  explicit Renderer(const std::string& device = "auto", int threads = 0);
  ~Renderer();
  Renderer(Renderer&&) noexcept;
  Renderer& operator=(Renderer&&) noexcept;

  // positions (count, 3), radii (count,) and values (count,) lie in the memory of `cuda_device`, -1 for the host; they
  // are copied when the renderer draws elsewhere. rgb receives height * width * 3 bytes, rows from the top.
  void draw(const Picture& picture, std::int64_t count, const float* positions, const float* radii, const float* values,
            int cuda_device, std::uint8_t* rgb);

 private:
  std::unique_ptr<RendererEngine> engine_;
};

}  // namespace fastcollide
