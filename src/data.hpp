// All that flows from stage to stage.
#pragma once

#include "backend/concept.hpp"
#include "physics/cell.hpp"
#include "physics/contact.hpp"

namespace fastcollide {

// state_hash() gives a place to 2^28 spheres, and no list of cells or ids outgrows 32 bits.
inline constexpr std::int64_t most_spheres = std::int64_t(1) << 28;

// The state, in the order of the ids: what users see and what state_hash() covers.
template <Backend B>
struct Bodies {
  explicit Bodies(B& backend)
      : positions(backend),
        velocities(backend),
        radii(backend),
        masses(backend),
        restitutions(backend),
        spins(backend),
        frictions(backend) {}

  std::int64_t count() const { return radii.size(); }
  void resize(std::int64_t count) {
    positions.resize(count);
    velocities.resize(count);
    radii.resize(count);
    masses.resize(count);
    restitutions.resize(count);
    if (is_rough) {
      spins.resize(count);
      frictions.resize(count);
    }
  }

  typename B::template Buffer<Vec3> positions;      // [m]
  typename B::template Buffer<Vec3> velocities;     // [m/s]
  typename B::template Buffer<float> radii;         // [m]
  typename B::template Buffer<float> masses;        // [kg]
  typename B::template Buffer<float> restitutions;  // 0 ... 1

  // Only where there is friction or spin; without, a world has no memory for them.
  bool is_rough = false;
  typename B::template Buffer<Vec3> spins;       // [rad/s]
  typename B::template Buffer<float> frictions;  // Coulomb coefficient
};

// Spheres sorted by (cell, id). A slot is a place in that order; the state is copied there, so that a stage reads one
// buffer (the slots) and writes the other (the bodies).
template <Backend B>
struct Grid {
  explicit Grid(B& backend)
      : unsorted_cells(backend),
        unsorted_ids(backend),
        cells(backend),
        ids(backend),
        cell_start(backend),
        cell_end(backend),
        position_radius(backend),
        velocity_restitution(backend),
        masses(backend),
        crowding(backend),
        spins(backend),
        frictions(backend) {}

  GridShape shape{};
  Vec3 period{};
  typename B::template Buffer<std::uint32_t> unsorted_cells, unsorted_ids;
  typename B::template Buffer<std::uint32_t> cells, ids;            // of each slot
  typename B::template Buffer<std::uint32_t> cell_start, cell_end;  // slots of each cell: [start, end)
  typename B::template Buffer<Vec4> position_radius, velocity_restitution;
  typename B::template Buffer<float> masses;
  typename B::template Buffer<float> crowding;  // for the default solver
  // Of a rough world:
  typename B::template Buffer<Vec3> spins;
  typename B::template Buffer<float> frictions;
};

// The slots as a stage reads them.
struct GridView {
  GridShape shape;
  Vec3 period;  // of the periodic axes, 0 for the others [m]
  std::int64_t count;
  const std::uint32_t* ids;
  const std::uint32_t* cell_start;
  const std::uint32_t* cell_end;
  const Vec4* position_radius;
  const Vec4* velocity_restitution;
  const float* masses;
  const float* crowding;
  const Vec3* spins;       // or null
  const float* frictions;  // or null
};

template <Backend B>
GridView view_of(const Grid<B>& grid) {
  return {grid.shape,
          grid.period,
          grid.ids.size(),
          grid.ids.data(),
          grid.cell_start.data(),
          grid.cell_end.data(),
          grid.position_radius.data(),
          grid.velocity_restitution.data(),
          grid.masses.data(),
          grid.crowding.data(),
          grid.spins.data(),
          grid.frictions.data()};
}

FC_HOST_DEVICE inline Sphere sphere_in_slot(const GridView& grid, std::int64_t slot) {
  const Vec4 a = grid.position_radius[slot], b = grid.velocity_restitution[slot];
  return {{a.x, a.y, a.z}, a.w, {b.x, b.y, b.z}, b.w, grid.masses[slot], grid.ids[slot]};
}

// Overlapping pairs, first < second, sorted by (first, second).
template <Backend B>
struct Contacts {
  explicit Contacts(B& backend) : offsets(backend), first(backend), second(backend), gap(backend), normal(backend) {}

  typename B::template Buffer<std::int64_t> offsets;         // of each sphere as first, one more than spheres
  typename B::template Buffer<std::uint32_t> first, second;  // ids
  typename B::template Buffer<float> gap;                    // distance of the surfaces, negative in overlap [m]
  typename B::template Buffer<Vec3> normal;                  // from first to second
};

// The first thing that went wrong in a run, as one word that atomic_min can keep: the earliest frame, then the smallest
// id, whatever thread saw it first.
enum class FaultKind : std::uint8_t { not_finite = 1, out_of_range = 2, too_many_contacts = 3, out_of_reach = 4 };

inline constexpr std::uint64_t no_fault = ~std::uint64_t(0);

FC_HOST_DEVICE inline std::uint64_t fault_word(std::uint32_t frame, std::uint32_t id, FaultKind kind) {
  return (std::uint64_t(frame & 0xFFFFFFu) << 40) | (std::uint64_t(id) << 8) | std::uint64_t(kind);
}
FC_HOST_DEVICE inline std::uint32_t fault_frame(std::uint64_t fault) { return static_cast<std::uint32_t>(fault >> 40); }

// What a run is watched for, from all spheres at once and in no order.
struct Watch {
  std::uint64_t first_fault = no_fault;
  std::uint64_t fast_spheres = 0;    // that flew farther than their radius in one step, added up over the steps
  std::uint64_t longest_flight = 0;  // of these, in radii of the sphere: the bits of a float
};

// A sphere that flies farther than its radius in one step, from one look at its neighbours to the next, may pass
// through another one unseen.
FC_HOST_DEVICE inline void watch_flight(Watch* watch, Vec3 flight, float radius) {
  const float in_radii = length(flight * (1.0f / radius));
  if (!(in_radii > 1.0f)) return;
  atomic_count(&watch->fast_spheres);
  atomic_max(&watch->longest_flight, bits_of(smaller(in_radii, 1e18f)));
}

}  // namespace fastcollide
