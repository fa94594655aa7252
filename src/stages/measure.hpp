// Energy, momentum, overlap and the hash of the state. Every sum is one of integers, so each number has the same bits
// on every device.
#pragma once

#include <bit>
#include <cmath>

#include "../physics/wall.hpp"
#include "find_pairs.hpp"

namespace fastcollide {

struct Larger {
  template <class T>
  FC_HOST_DEVICE T operator()(T a, T b) const {
    return a < b ? b : a;
  }
};

// What one sphere adds to the ledger, in double precision. A fixed one, which no energy could stop, adds nothing.
struct Share {
  double kinetic, rotational, potential;  // [J]
  double momentum[3];                     // [kg m/s]
  double angular_momentum[3];             // about the origin [kg m²/s]
};

struct ShareOfBody {
  Vec3 gravity, lower;
  const Vec3* positions;
  const Vec3* velocities;
  const float* masses;
  const float* radii;
  const Vec3* spins;  // or null

  FC_HOST_DEVICE Share share(std::int64_t i) const {
    if (is_fixed(masses[i])) return {};
    const double m = masses[i];
    const double vx = velocities[i].x, vy = velocities[i].y, vz = velocities[i].z;
    const double height = double(gravity.x) * (double(positions[i].x) - double(lower.x)) +
                          double(gravity.y) * (double(positions[i].y) - double(lower.y)) +
                          double(gravity.z) * (double(positions[i].z) - double(lower.z));
    const double x = positions[i].x, y = positions[i].y, z = positions[i].z;
    Share share{0.5 * m * (vx * vx + vy * vy + vz * vz),
                0,
                -m * height,
                {m * vx, m * vy, m * vz},
                {m * (y * vz - z * vy), m * (z * vx - x * vz), m * (x * vy - y * vx)}};
    if (spins != nullptr) {
      const double inertia = 0.4 * m * radii[i] * radii[i];  // of a solid sphere
      const double wx = spins[i].x, wy = spins[i].y, wz = spins[i].z;
      share.rotational = 0.5 * inertia * (wx * wx + wy * wy + wz * wz);
      share.angular_momentum[0] += inertia * wx;
      share.angular_momentum[1] += inertia * wy;
      share.angular_momentum[2] += inertia * wz;
    }
    return share;
  }
};

FC_HOST_DEVICE inline double largest_of(const double (&values)[3]) {
  const Larger larger;
  return larger(fabs(values[0]), larger(fabs(values[1]), fabs(values[2])));
}

// The largest magnitudes: they set the scale of the sums.
struct LargestShare {
  double energy = 0, momentum = 0, angular_momentum = 0;
  struct Operation {
    FC_HOST_DEVICE LargestShare operator()(LargestShare a, LargestShare b) const {
      return {Larger{}(a.energy, b.energy), Larger{}(a.momentum, b.momentum),
              Larger{}(a.angular_momentum, b.angular_momentum)};
    }
  };
};

struct MagnitudeOfShare {
  ShareOfBody body;

  FC_HOST_DEVICE LargestShare operator()(std::int64_t i) const {
    const Share share = body.share(i);
    const Larger larger;
    return {larger(larger(share.kinetic, share.rotational), fabs(share.potential)), largest_of(share.momentum),
            largest_of(share.angular_momentum)};
  }
};

struct LedgerSums {
  std::int64_t kinetic = 0, rotational = 0, potential = 0, momentum[3] = {0, 0, 0}, angular_momentum[3] = {0, 0, 0};
  struct Operation {
    FC_HOST_DEVICE LedgerSums operator()(LedgerSums a, const LedgerSums& b) const {
      a.kinetic += b.kinetic;
      a.rotational += b.rotational;
      a.potential += b.potential;
      for (int k = 0; k < 3; ++k) {
        a.momentum[k] += b.momentum[k];
        a.angular_momentum[k] += b.angular_momentum[k];
      }
      return a;
    }
  };
};

struct RoundShare {
  double energy_scale, momentum_scale, angular_momentum_scale;  // powers of two
  ShareOfBody body;

  FC_HOST_DEVICE LedgerSums operator()(std::int64_t i) const {
    const Share share = body.share(i);
    LedgerSums sums;
    sums.kinetic = round_to_int64(share.kinetic * energy_scale);
    sums.rotational = round_to_int64(share.rotational * energy_scale);
    sums.potential = round_to_int64(share.potential * energy_scale);
    for (int k = 0; k < 3; ++k) {
      sums.momentum[k] = round_to_int64(share.momentum[k] * momentum_scale);
      sums.angular_momentum[k] = round_to_int64(share.angular_momentum[k] * angular_momentum_scale);
    }
    return sums;
  }
};

struct Ledger {
  double kinetic = 0, rotational = 0, potential = 0;  // [J]
  double momentum[3] = {0, 0, 0};                     // [kg m/s]
  double angular_momentum[3] = {0, 0, 0};             // about the origin [kg m²/s]
};

// Heights count from the lower corner; along an open axis, which has none, from 0.
inline Vec3 height_origin(const Box& box) {
  const auto of = [](float lower, Boundary boundary) { return boundary == Boundary::open ? 0.0f : lower; };
  return {of(box.lower.x, box.x), of(box.lower.y, box.y), of(box.lower.z, box.z)};
}

// The power of two by which to scale terms of up to this magnitude, so that `count` of them do not overflow 62 bits.
inline int exponent_for(double magnitude, std::int64_t count) {
  int exponent = 0;
  std::frexp(magnitude, &exponent);
  return magnitude > 0 ? 62 - static_cast<int>(std::bit_width(static_cast<std::uint64_t>(count))) - exponent : 0;
}

template <Backend B>
Ledger measure_ledger(B& backend, Vec3 gravity, const Box& box, const Bodies<B>& bodies) {
  const std::int64_t count = bodies.count();
  const ShareOfBody body{gravity,
                         height_origin(box),
                         bodies.positions.data(),
                         bodies.velocities.data(),
                         bodies.masses.data(),
                         bodies.radii.data(),
                         bodies.spins.data()};
  const LargestShare largest =
      backend.transform_reduce(count, MagnitudeOfShare{body}, LargestShare{}, LargestShare::Operation{});
  const int energy = exponent_for(largest.energy, count), momentum = exponent_for(largest.momentum, count);
  const int angular_momentum = exponent_for(largest.angular_momentum, count);
  const LedgerSums sums = backend.transform_reduce(
      count, RoundShare{std::ldexp(1.0, energy), std::ldexp(1.0, momentum), std::ldexp(1.0, angular_momentum), body},
      LedgerSums{}, LedgerSums::Operation{});
  const auto value = [](std::int64_t sum, int exponent) { return std::ldexp(static_cast<double>(sum), -exponent); };
  Ledger ledger{value(sums.kinetic, energy), value(sums.rotational, energy), value(sums.potential, energy), {}, {}};
  for (int k = 0; k < 3; ++k) {
    ledger.momentum[k] = value(sums.momentum[k], momentum);
    ledger.angular_momentum[k] = value(sums.angular_momentum[k], angular_momentum);
  }
  return ledger;
}

// Two fixed spheres in contact never part.
FC_HOST_DEVICE inline bool can_part(const GridView& grid, std::int64_t a, std::int64_t b) {
  return !is_fixed(grid.mass_ids[a].mass) || !is_fixed(grid.mass_ids[b].mass);
}

// Of two that are in contact, which was decided in double precision; measured in single.
FC_HOST_DEVICE inline float overlap_of(const GridView& grid, std::int64_t slot, std::int64_t other) {
  const Vec4 here = grid.position_radius[slot], there = grid.position_radius[other];
  const ContactGeometry contact =
      contact_geometry({here.x, here.y, here.z}, here.w, grid.mass_ids[slot].id, {there.x, there.y, there.z}, there.w,
                       grid.mass_ids[other].id, grid.period);
  return larger(contact.depth, 0.0f);
}

// Calls visit(other, depth) for each contact of a slot with a larger id that could part them.
template <class Visit>
FC_HOST_DEVICE inline void visit_overlaps_of(const GridView& grid, const CellNeighbors& neighbors, std::int64_t slot,
                                             Visit& visit) {
  auto visit_pair = [&](std::int64_t other) {
    if (can_part(grid, slot, other)) visit(other, overlap_of(grid, slot, other));
  };
  visit_pairs_of(grid, neighbors, slot, visit_pair);
}

FC_HOST_DEVICE inline float deepest_in_walls(const GridView& grid, std::int64_t slot, const Box& box) {
  float deepest = 0.0f;
  auto visit_wall = [&](Vec3, float depth, bool) { deepest = larger(deepest, depth); };
  const Vec4 here = grid.position_radius[slot];
  if (!is_fixed(grid.mass_ids[slot].mass)) visit_walls({here.x, here.y, here.z}, here.w, box, visit_wall);
  return deepest;
}

// Into another sphere or, of a sphere that walls hold, into a wall. Non-negative floats order like their bits.
struct DeepestOverlap {
  Box box;
  GridView grid;
  CellNeighbors neighbors;

  FC_HOST_DEVICE std::uint32_t operator()(std::int64_t slot) const {
    float deepest = deepest_in_walls(grid, slot, box);
    auto visit = [&](std::int64_t, float depth) { deepest = larger(deepest, depth); };
    visit_overlaps_of(grid, neighbors, slot, visit);
    return bits_of(deepest);
  }
};

template <Backend B>
float measure_max_overlap(B& backend, const Box& box, const Grid<B>& grid) {
  const DeepestOverlap overlap{box, view_of(grid), neighbors_in(grid)};
  return float_of(backend.transform_reduce(grid.ids.size(), overlap, std::uint32_t(0), Larger{}));
}

// Contacts of each slot and their largest overlap, as a part of the smaller radius: they set the scale of the sum.
struct OverlapSize {
  std::int64_t count = 0;
  double largest = 0;
  struct Operation {
    FC_HOST_DEVICE OverlapSize operator()(OverlapSize a, const OverlapSize& b) const {
      return {a.count + b.count, Larger{}(a.largest, b.largest)};
    }
  };
};

FC_HOST_DEVICE inline double part_of_smaller_radius(float depth, const GridView& grid, std::int64_t a, std::int64_t b) {
  return double(depth) / double(smaller(grid.position_radius[a].w, grid.position_radius[b].w));
}

struct SizeOfOverlaps {
  GridView grid;
  CellNeighbors neighbors;

  FC_HOST_DEVICE OverlapSize operator()(std::int64_t slot) const {
    OverlapSize size;
    auto visit = [&](std::int64_t other, float depth) {
      size = OverlapSize::Operation{}(size, {1, part_of_smaller_radius(depth, grid, slot, other)});
    };
    visit_overlaps_of(grid, neighbors, slot, visit);
    return size;
  }
};

struct RoundOverlaps {
  double scale;  // a power of two
  GridView grid;
  CellNeighbors neighbors;

  FC_HOST_DEVICE std::int64_t operator()(std::int64_t slot) const {
    std::int64_t sum = 0;
    auto visit = [&](std::int64_t other, float depth) {
      sum += round_to_int64(part_of_smaller_radius(depth, grid, slot, other) * scale);
    };
    visit_overlaps_of(grid, neighbors, slot, visit);
    return sum;
  }
};

inline double mean_of_sum(std::int64_t sum, int exponent, std::int64_t count) {
  return std::ldexp(static_cast<double>(sum), -exponent) / static_cast<double>(count);
}

template <Backend B>
double measure_mean_overlap(B& backend, const Grid<B>& grid) {
  const std::int64_t slots = grid.ids.size();
  const OverlapSize size = backend.transform_reduce(slots, SizeOfOverlaps{view_of(grid), neighbors_in(grid)},
                                                    OverlapSize{}, OverlapSize::Operation{});
  if (size.count == 0) return 0.0;
  const int exponent = exponent_for(size.largest, size.count);
  const RoundOverlaps overlaps{std::ldexp(1.0, exponent), view_of(grid), neighbors_in(grid)};
  const std::int64_t sum = backend.transform_reduce(slots, overlaps, std::int64_t(0), Sum{});
  return mean_of_sum(sum, exponent, size.count);
}

// state_hash = mix64(count + sum over all numbers of mix64(bits + 2^32 (16 index + field))): the bits of every number
// with its place, in a sum that needs no order.
struct HashBody {
  const Vec3* positions;
  const Vec3* velocities;
  const float* radii;
  const float* masses;
  const float* restitutions;
  const Vec3* spins;       // or null
  const float* frictions;  // or null

  FC_HOST_DEVICE static std::uint64_t word(float x, std::int64_t i, int field) {
    // The place takes the upper 32 bits: 16 fields for each of 2^28 spheres, the largest count of a world.
    return mix64(bits_of(x) + ((std::uint64_t(i) * 16 + std::uint64_t(field)) << 32));
  }
  // A world that keeps zeros and one that keeps nothing are in the same state.
  FC_HOST_DEVICE static std::uint64_t word_if_any(float x, std::int64_t i, int field) {
    return bits_of(x) == 0 ? 0 : word(x, i, field);
  }
  FC_HOST_DEVICE std::uint64_t operator()(std::int64_t i) const {
    const Vec3 x = positions[i], v = velocities[i];
    std::uint64_t sum = word(x.x, i, 0) + word(x.y, i, 1) + word(x.z, i, 2) + word(v.x, i, 3) + word(v.y, i, 4) +
                        word(v.z, i, 5) + word(radii[i], i, 6) + word(masses[i], i, 7) + word(restitutions[i], i, 8);
    if (spins != nullptr) {
      const Vec3 w = spins[i];
      sum +=
          word_if_any(w.x, i, 9) + word_if_any(w.y, i, 10) + word_if_any(w.z, i, 11) + word_if_any(frictions[i], i, 12);
    }
    return sum;
  }
};

template <Backend B>
std::uint64_t hash_state(B& backend, const Bodies<B>& bodies) {
  const HashBody hash{bodies.positions.data(), bodies.velocities.data(),   bodies.radii.data(),
                      bodies.masses.data(),    bodies.restitutions.data(), bodies.spins.data(),
                      bodies.frictions.data()};
  const std::uint64_t sum = backend.transform_reduce(bodies.count(), hash, std::uint64_t(0), Sum{});
  return mix64(sum + static_cast<std::uint64_t>(bodies.count()));
}

}  // namespace fastcollide
