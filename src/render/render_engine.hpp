// The renderer behind the interface that knows no backend.
#pragma once

#include <cstring>
#include <utility>

#include "../engine.hpp"
#include "renderer.hpp"

namespace fastcollide {

template <Backend B>
class RenderEngineOn final : public RendererEngine {
 public:
  explicit RenderEngineOn(B backend) : backend_(std::move(backend)) {}

  void draw(const Picture& picture, std::int64_t count, const float* positions, const float* radii, const float* values,
            int cuda_device, std::uint8_t* rgb) override {
    render::PictureOptions options;
    options.width = picture.width;
    options.height = picture.height;
    options.supersampling = picture.supersampling;
    options.lower = vector_of(picture.box_lower);
    options.upper = vector_of(picture.box_upper);
    static_assert(sizeof options.color_table == sizeof picture.color_table);
    std::memcpy(options.color_table, picture.color_table.data(), sizeof options.color_table);
    options.value_low = picture.value_low;
    options.value_high = picture.value_high;
    const render::Camera camera{vector_of(picture.eye), vector_of(picture.target), vector_of(picture.up),
                                picture.tan_half_field};
    if (cuda_device == backend_.cuda_device()) {
      return renderer_.draw(options, camera, count, positions, radii, values, rgb);
    }
    if (cuda_device >= 0) {
      throw DeviceError("the arrays lie on cuda:" + std::to_string(cuda_device) +
                        ", another device than the renderer's");
    }
    const auto upload = [&](auto& buffer, const float* host, std::int64_t n) {
      buffer.resize(n);
      backend_.copy_to_device(buffer.data(), host, n);
    };
    upload(positions_, positions, 3 * count);
    upload(radii_, radii, count);
    upload(values_, values, count);
    renderer_.draw(options, camera, count, positions_.data(), radii_.data(), values_.data(), rgb);
  }

 private:
  B backend_;
  render::Renderer<B> renderer_{backend_};
  typename B::template Buffer<float> positions_{backend_}, radii_{backend_}, values_{backend_};
};

}  // namespace fastcollide
