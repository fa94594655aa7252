// Is every number of the state in its range? Arrays are the user's to write, so each run asks first.
#pragma once

#include "../data.hpp"

namespace fastcollide {

enum class Field : std::uint8_t { position, velocity, radius, mass, restitution, spin, friction };

struct StateCheck {
  std::uint64_t first_bad = no_fault;  // id * 8 + field
  std::uint64_t largest_radius = 0;    // bits of a positive float; as wide as the other, to leave no gap between them
  std::uint64_t smallest_radius = ~std::uint64_t(0);  // likewise
  std::uint64_t largest_friction = 0;                 // likewise
  std::uint64_t radius_digest = 0;                    // changes when a radius does
  struct Operation {
    FC_HOST_DEVICE StateCheck operator()(StateCheck a, const StateCheck& b) const {
      if (b.first_bad < a.first_bad) a.first_bad = b.first_bad;
      if (b.largest_radius > a.largest_radius) a.largest_radius = b.largest_radius;
      if (b.smallest_radius < a.smallest_radius) a.smallest_radius = b.smallest_radius;
      if (b.largest_friction > a.largest_friction) a.largest_friction = b.largest_friction;
      a.radius_digest += b.radius_digest;
      return a;
    }
  };
};

inline constexpr float largest_friction = 1e6f;

struct CheckBody {
  Box box;
  float smallest_radius, largest_radius;  // that the box and float32 allow
  const Vec3* positions;
  const Vec3* velocities;
  const float* radii;
  const float* masses;
  const float* restitutions;
  const Vec3* spins;       // or null
  const float* frictions;  // or null

  FC_HOST_DEVICE StateCheck operator()(std::int64_t i) const {
    const auto bad = [i](Field field) {
      return StateCheck{std::uint64_t(i) * 8 + std::uint64_t(field), 0, ~std::uint64_t(0), 0, 0};
    };
    if (!(radii[i] >= smallest_radius && radii[i] <= largest_radius)) return bad(Field::radius);
    if (!is_finite(positions[i]) || !is_in_reach(positions[i], radii[i], box)) return bad(Field::position);
    if (!is_finite(velocities[i])) return bad(Field::velocity);
    if (!(masses[i] > 0.0f && (masses[i] <= largest_mass || !is_finite(masses[i])))) return bad(Field::mass);
    if (!(restitutions[i] >= 0.0f && restitutions[i] <= 1.0f)) return bad(Field::restitution);
    if (spins != nullptr && !is_finite(spins[i])) return bad(Field::spin);
    if (frictions != nullptr && !(frictions[i] >= 0.0f && frictions[i] <= largest_friction))
      return bad(Field::friction);
    const std::uint64_t radius = bits_of(radii[i]);
    return {no_fault, radius, radius, frictions == nullptr ? 0u : bits_of(frictions[i]),
            mix64(std::uint64_t(i) << 32 | radius)};
  }
};

// How many spheres are smaller than each limit.
struct SmallerCounts {
  std::uint32_t counts[octaves - 1] = {};
  struct Operation {
    FC_HOST_DEVICE SmallerCounts operator()(SmallerCounts a, const SmallerCounts& b) const {
      for (int i = 0; i < octaves - 1; ++i) a.counts[i] += b.counts[i];
      return a;
    }
  };
};

// Limits from octave to octave. (To compare the number of the octave with each would be simpler, but nvcc 13.0 then
// counts every sphere in the last one.)
struct SmallerThanLimits {
  const float* radii;
  float limits[octaves - 1];

  FC_HOST_DEVICE SmallerCounts operator()(std::int64_t i) const {
    SmallerCounts found;
    for (int k = 0; k < octaves - 1; ++k) found.counts[k] = radii[i] < limits[k] ? 1 : 0;
    return found;
  }
};

// Along a periodic axis the user may put a sphere anywhere: it is where it comes in again.
struct BringIn {
  Box box;
  Vec3* positions;

  FC_HOST_DEVICE void operator()(std::int64_t i) const { positions[i] = first_image(positions[i], box); }
};

template <Backend B>
void bring_in(B& backend, const Box& box, Bodies<B>& bodies) {
  const bool is_any = box.x == Boundary::periodic || box.y == Boundary::periodic || box.z == Boundary::periodic;
  if (is_any) backend.for_each(bodies.count(), BringIn{box, bodies.positions.data()});
}

template <Backend B>
StateCheck check_state(B& backend, const Box& box, float smallest_radius, float largest_radius,
                       const Bodies<B>& bodies) {
  return backend.transform_reduce(bodies.count(),
                                  CheckBody{box, smallest_radius, largest_radius, bodies.positions.data(),
                                            bodies.velocities.data(), bodies.radii.data(), bodies.masses.data(),
                                            bodies.restitutions.data(), bodies.spins.data(), bodies.frictions.data()},
                                  StateCheck{}, StateCheck::Operation{});
}

}  // namespace fastcollide
