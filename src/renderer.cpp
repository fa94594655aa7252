// Validation and choice of the device for pictures.
#include "fastcollide/renderer.hpp"

#include <cmath>

#include "device_choice.hpp"
#include "engine.hpp"

namespace fastcollide {
namespace {

void require_range(const char* field, int found, int least, int most) {
  if (found >= least && found <= most) return;
  throw InvalidValue(field, -1, std::to_string(found), std::to_string(least) + " to " + std::to_string(most));
}

void check_picture(const Picture& picture) {
  constexpr int most_pixels = 16384;
  require_range("width", picture.width, 1, most_pixels);
  require_range("height", picture.height, 1, most_pixels);
  require_range("supersampling", picture.supersampling, 1, 4);
  const Vec3 eye = vector_of(picture.eye), target = vector_of(picture.target), up = vector_of(picture.up);
  if (!is_finite(eye) || !is_finite(target) || !is_finite(up) || !(length(cross(target - eye, up)) > 0)) {
    throw InvalidValue("camera", -1, "no direction",
                       "an eye apart from its target, and an up that is not along the view");
  }
  if (!(picture.tan_half_field > 0 && is_finite(picture.tan_half_field))) {
    throw InvalidValue("field_of_view", -1, std::to_string(picture.tan_half_field),
                       "more than 0 and less than 180 degrees");
  }
}

std::unique_ptr<RendererEngine> make_renderer(const std::string& device, int threads) {
  const int number = choose_device(device), chosen_threads = choose_threads(threads);
  return number == cpu_device ? make_cpu_renderer(chosen_threads) : make_cuda_renderer(number);
}

}  // namespace

Renderer::Renderer(const std::string& device, int threads) : engine_(make_renderer(device, threads)) {}
Renderer::~Renderer() = default;
Renderer::Renderer(Renderer&&) noexcept = default;
Renderer& Renderer::operator=(Renderer&&) noexcept = default;

void Renderer::draw(const Picture& picture, std::int64_t count, const float* positions, const float* radii,
                    const float* values, int cuda_device, std::uint8_t* rgb) {
  check_picture(picture);
  engine_->draw(picture, count, positions, radii, values, cuda_device, rgb);
}

}  // namespace fastcollide
