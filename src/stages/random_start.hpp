// The report's random start.
#pragma once

#include "../data.hpp"
#include "../physics/random.hpp"
#include "fastcollide/spheres.hpp"

namespace fastcollide {

struct RandomStart {
  std::uint64_t seed;
  Box box;
  float radius_low, radius_high;
  Vec3 speed;
  float restitution_low, restitution_high;
  float density;
  Vec3* positions;
  Vec3* velocities;
  float* radii;
  float* masses;
  float* restitutions;

  FC_HOST_DEVICE void operator()(std::int64_t i) const {
    const std::uint64_t id = static_cast<std::uint64_t>(i);
    const RandomWords place = random_words(seed, id, 0), motion = random_words(seed, id, 1);
    const float radius = uniform(place.word[3], radius_low, radius_high);
    radii[i] = radius;
    positions[i] = {uniform(place.word[0], box.lower.x + radius, box.upper.x - radius),
                    uniform(place.word[1], box.lower.y + radius, box.upper.y - radius),
                    uniform(place.word[2], box.lower.z + radius, box.upper.z - radius)};
    velocities[i] = {uniform(motion.word[0], -speed.x, speed.x), uniform(motion.word[1], -speed.y, speed.y),
                     uniform(motion.word[2], 0.0f, speed.z)};
    restitutions[i] = uniform(motion.word[3], restitution_low, restitution_high);
    masses[i] = density * (4.18879020f * (radius * radius * radius));  // 4/3 pi
  }
};

template <Backend B>
Spheres random_start(B& backend, const RandomSpheres& random) {
  Bodies<B> bodies(backend);
  bodies.resize(random.count);
  const auto vector = [](const std::array<float, 3>& a) { return Vec3{a[0], a[1], a[2]}; };
  backend.for_each(random.count, RandomStart{random.seed,
                                             {vector(random.lower), vector(random.upper), {}, {}, {}},
                                             random.radius[0],
                                             random.radius[1],
                                             vector(random.speed),
                                             random.restitution[0],
                                             random.restitution[1],
                                             random.density,
                                             bodies.positions.data(),
                                             bodies.velocities.data(),
                                             bodies.radii.data(),
                                             bodies.masses.data(),
                                             bodies.restitutions.data()});
  Spheres spheres;
  const auto read = [&](std::vector<float>& host, const void* device, int columns) {
    host.resize(static_cast<std::size_t>(random.count * columns));
    backend.copy_to_host(host.data(), static_cast<const float*>(device), random.count * columns);
  };
  read(spheres.position, bodies.positions.data(), 3);
  read(spheres.velocity, bodies.velocities.data(), 3);
  read(spheres.radius, bodies.radii.data(), 1);
  read(spheres.mass, bodies.masses.data(), 1);
  read(spheres.restitution, bodies.restitutions.data(), 1);
  return spheres;
}

}  // namespace fastcollide
