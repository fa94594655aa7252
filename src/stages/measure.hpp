// Energy, momentum, overlap and the hash of the state. Every sum is one of integers, so each number has the same bits
// on every device.
#pragma once

#include <bit>
#include <cmath>

#include "find_pairs.hpp"

namespace fastcollide {

struct Larger {
  template <class T>
  FC_HOST_DEVICE T operator()(T a, T b) const {
    return a < b ? b : a;
  }
};

// What one sphere adds to the ledger, in double precision.
struct Share {
  double kinetic, potential;  // [J]
  double momentum[3];         // [kg m/s]
};

struct ShareOfBody {
  Vec3 gravity, lower;
  const Vec3* positions;
  const Vec3* velocities;
  const float* masses;

  FC_HOST_DEVICE Share share(std::int64_t i) const {
    const double m = masses[i];
    const double vx = velocities[i].x, vy = velocities[i].y, vz = velocities[i].z;
    const double height = double(gravity.x) * (double(positions[i].x) - double(lower.x)) +
                          double(gravity.y) * (double(positions[i].y) - double(lower.y)) +
                          double(gravity.z) * (double(positions[i].z) - double(lower.z));
    return {0.5 * m * (vx * vx + vy * vy + vz * vz), -m * height, {m * vx, m * vy, m * vz}};
  }
};

// The largest magnitudes: they set the scale of the sums.
struct LargestShare {
  double energy = 0, momentum = 0;
  struct Operation {
    FC_HOST_DEVICE LargestShare operator()(LargestShare a, LargestShare b) const {
      return {Larger{}(a.energy, b.energy), Larger{}(a.momentum, b.momentum)};
    }
  };
};

struct MagnitudeOfShare {
  ShareOfBody body;

  FC_HOST_DEVICE LargestShare operator()(std::int64_t i) const {
    const Share share = body.share(i);
    const Larger larger;
    return {larger(share.kinetic, fabs(share.potential)),
            larger(fabs(share.momentum[0]), larger(fabs(share.momentum[1]), fabs(share.momentum[2])))};
  }
};

struct LedgerSums {
  std::int64_t kinetic = 0, potential = 0, momentum[3] = {0, 0, 0};
  struct Operation {
    FC_HOST_DEVICE LedgerSums operator()(LedgerSums a, const LedgerSums& b) const {
      a.kinetic += b.kinetic;
      a.potential += b.potential;
      for (int k = 0; k < 3; ++k) a.momentum[k] += b.momentum[k];
      return a;
    }
  };
};

struct RoundShare {
  double energy_scale, momentum_scale;  // powers of two
  ShareOfBody body;

  FC_HOST_DEVICE LedgerSums operator()(std::int64_t i) const {
    const Share share = body.share(i);
    LedgerSums sums;
    sums.kinetic = round_to_int64(share.kinetic * energy_scale);
    sums.potential = round_to_int64(share.potential * energy_scale);
    for (int k = 0; k < 3; ++k) sums.momentum[k] = round_to_int64(share.momentum[k] * momentum_scale);
    return sums;
  }
};

struct Ledger {
  double kinetic = 0, potential = 0;  // [J]
  double momentum[3] = {0, 0, 0};     // [kg m/s]
};

// Heights count from the lower corner; along an open axis, which has none, from 0.
inline Vec3 height_origin(const Box& box) {
  const auto of = [](float lower, Boundary boundary) { return boundary == Boundary::open ? 0.0f : lower; };
  return {of(box.lower.x, box.x), of(box.lower.y, box.y), of(box.lower.z, box.z)};
}

template <Backend B>
Ledger measure_ledger(B& backend, Vec3 gravity, const Box& box, const Bodies<B>& bodies) {
  const std::int64_t count = bodies.count();
  const ShareOfBody body{gravity, height_origin(box), bodies.positions.data(), bodies.velocities.data(),
                         bodies.masses.data()};
  const LargestShare largest =
      backend.transform_reduce(count, MagnitudeOfShare{body}, LargestShare{}, LargestShare::Operation{});
  // Each term stays below 2^room, so that `count` of them cannot overflow 62 bits.
  const int room = 62 - static_cast<int>(std::bit_width(static_cast<std::uint64_t>(count)));
  const auto exponent_for = [room](double magnitude) {
    int exponent = 0;
    std::frexp(magnitude, &exponent);
    return magnitude > 0 ? room - exponent : 0;
  };
  const int energy = exponent_for(largest.energy), momentum = exponent_for(largest.momentum);
  const LedgerSums sums =
      backend.transform_reduce(count, RoundShare{std::ldexp(1.0, energy), std::ldexp(1.0, momentum), body},
                               LedgerSums{}, LedgerSums::Operation{});
  Ledger ledger{std::ldexp(static_cast<double>(sums.kinetic), -energy),
                std::ldexp(static_cast<double>(sums.potential), -energy),
                {}};
  for (int k = 0; k < 3; ++k) ledger.momentum[k] = std::ldexp(static_cast<double>(sums.momentum[k]), -momentum);
  return ledger;
}

// Non-negative floats order like their bits.
struct DeepestOverlap {
  GridView grid;

  FC_HOST_DEVICE std::uint32_t operator()(std::int64_t slot) const {
    const Vec4 here = grid.position_radius[slot];
    float deepest = 0.0f;
    auto visit = [&](std::int64_t other) {
      const Vec4 there = grid.position_radius[other];
      deepest = larger(deepest, contact_geometry({here.x, here.y, here.z}, here.w, grid.ids[slot],
                                                 {there.x, there.y, there.z}, there.w, grid.ids[other], grid.period)
                                    .depth);
    };
    visit_pairs_of(grid, slot, visit);
    return bits_of(deepest);
  }
};

template <Backend B>
float measure_max_overlap(B& backend, const Grid<B>& grid) {
  return float_of(backend.transform_reduce(grid.ids.size(), DeepestOverlap{view_of(grid)}, std::uint32_t(0), Larger{}));
}

// state_hash = mix64(count + sum over all numbers of mix64(bits + 2^32 (16 index + field))): the bits of every number
// with its place, in a sum that needs no order.
struct HashBody {
  const Vec3* positions;
  const Vec3* velocities;
  const float* radii;
  const float* masses;
  const float* restitutions;

  FC_HOST_DEVICE static std::uint64_t word(float x, std::int64_t i, int field) {
    // The place takes the upper 32 bits: 16 fields for each of 2^28 spheres, the largest count of a world.
    return mix64(bits_of(x) + ((std::uint64_t(i) * 16 + std::uint64_t(field)) << 32));
  }
  FC_HOST_DEVICE std::uint64_t operator()(std::int64_t i) const {
    const Vec3 x = positions[i], v = velocities[i];
    return word(x.x, i, 0) + word(x.y, i, 1) + word(x.z, i, 2) + word(v.x, i, 3) + word(v.y, i, 4) + word(v.z, i, 5) +
           word(radii[i], i, 6) + word(masses[i], i, 7) + word(restitutions[i], i, 8);
  }
};

template <Backend B>
std::uint64_t hash_state(B& backend, const Bodies<B>& bodies) {
  const HashBody hash{bodies.positions.data(), bodies.velocities.data(), bodies.radii.data(), bodies.masses.data(),
                      bodies.restitutions.data()};
  const std::uint64_t sum = backend.transform_reduce(bodies.count(), hash, std::uint64_t(0), Sum{});
  return mix64(sum + static_cast<std::uint64_t>(bodies.count()));
}

}  // namespace fastcollide
