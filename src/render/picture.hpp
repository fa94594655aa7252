// What a caller of the renderer says: where the camera stands, where the light comes from, what the picture is like.
// Lengths in metres, world axes right-handed with z up; the floor is the plane z = lower.z.
#pragma once

#include <cstdint>

#include "../math.hpp"

namespace fastcollide::render {

struct Camera {
  Vec3 eye, target;
  Vec3 up{0.0f, 0.0f, 1.0f};
  float tan_half_field = 0.25f;  // tangent of half the vertical field of view
};

struct Light {
  Vec3 towards{-0.42f, -0.30f, 0.86f};  // from the scene to the light; any length but zero
};

struct PictureOptions {
  int width = 1280, height = 720;                                // pixels
  int supersampling = 2;                                         // samples a pixel has along each axis, 1 to 4
  Vec3 lower{-10.0f, -10.0f, 0.0f}, upper{10.0f, 10.0f, 20.0f};  // the box whose edges and floor are drawn
  std::uint8_t color_table[256][3] = {};                         // sRGB, from value_low to value_high
  float value_low = 0.0f, value_high = 1.0f;
  Light light;
};

}  // namespace fastcollide::render
