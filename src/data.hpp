// All that flows from stage to stage.
#pragma once

#include "backend/concept.hpp"
#include "physics/contact.hpp"
#include "physics/levels.hpp"

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

// What is read together lies together: who a sphere is, and how it turns and rubs.
struct alignas(8) MassId {
  float mass;  // [kg]
  std::uint32_t id;
};
struct alignas(16) Spin {
  Vec3 rate;       // [rad/s]
  float friction;  // Coulomb coefficient; it stays as it is
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
        mass_ids(backend),
        crowding(backend),
        spins(backend) {}

  CellLevels levels{};  // one of them: as large as the largest sphere wants; several: by size
  Vec3 period{};
  typename B::template Buffer<std::uint32_t> unsorted_cells, unsorted_ids;
  typename B::template Buffer<std::uint32_t> cells, ids;            // of each slot
  typename B::template Buffer<std::uint32_t> cell_start, cell_end;  // slots of each cell: [start, end)
  typename B::template Buffer<Vec4> position_radius, velocity_restitution;
  typename B::template Buffer<MassId> mass_ids;
  typename B::template Buffer<float> crowding;  // for the default solver
  typename B::template Buffer<Spin> spins;      // of a rough world
};

// The slots as a stage reads them.
struct GridView {
  Vec3 period;  // of the periodic axes, 0 for the others [m]
  std::int64_t count;
  const Vec4* position_radius;
  const Vec4* velocity_restitution;
  const MassId* mass_ids;
  const float* crowding;
  const Spin* spins;  // or null
};

template <Backend B>
GridView view_of(const Grid<B>& grid) {
  return {grid.period,
          grid.ids.size(),
          grid.position_radius.data(),
          grid.velocity_restitution.data(),
          grid.mass_ids.data(),
          grid.crowding.data(),
          grid.spins.data()};
}

FC_HOST_DEVICE inline Sphere sphere_in_slot(const GridView& grid, std::int64_t slot) {
  const Vec4 a = grid.position_radius[slot], b = grid.velocity_restitution[slot];
  const MassId who = grid.mass_ids[slot];
  return {{a.x, a.y, a.z}, a.w, {b.x, b.y, b.z}, b.w, who.mass, who.id};
}

FC_HOST_DEVICE inline Vec3 velocity_in_slot(const GridView& grid, std::int64_t slot) {
  const Vec4 velocity = grid.velocity_restitution[slot];
  return {velocity.x, velocity.y, velocity.z};
}

// The state as a list form keeps it from pass to pass: in the order of the cells of the last sort. A pass reads one
// copy and writes the other.
struct SlotState {
  Vec4* position_radius;
  Vec4* velocity_restitution;
  float* crowding;  // or null: of the default solver
  Spin* spins;      // or null
};

FC_HOST_DEVICE inline GridView view_of(const SlotState& state, const MassId* mass_ids, std::int64_t count,
                                       Vec3 period) {
  return {period, count, state.position_radius, state.velocity_restitution, mass_ids, state.crowding, state.spins};
}

// Entries of one lane of one sphere: those that are there for all to see, and with those being added right now.
struct alignas(8) ListCount {
  std::uint32_t published, pending;
};

// For each lane of each sphere, the slots that are near: `capacity` places, `width` lanes side by side, so that the
// lanes of a GPU read neighbouring words and a CPU reads one list from front to back.
struct NeighborLists {
  std::uint32_t* entries;
  ListCount* counts;
  std::uint32_t capacity, width, lanes;

  FC_HOST_DEVICE std::uint32_t* of_row(std::int64_t row) const {
    return entries + (row / width) * (std::int64_t(capacity) * width) + row % width;
  }
};

// A sphere that left its skin, and where its list began until then: place and skin.
struct QueuedSphere {
  Vec4 start;
  std::uint32_t slot;
};

// What a pass tells the next one.
struct alignas(8) ListNews {
  std::uint32_t is_stale;  // the lists must be made anew
  std::uint32_t queued;    // spheres that left the skin of their list
};

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
enum class FaultKind : std::uint8_t {
  not_finite = 1,
  out_of_range = 2,
  too_many_contacts = 3,
  out_of_reach = 4,
  memory_full = 5
};

inline constexpr std::uint64_t no_fault = ~std::uint64_t(0);

FC_HOST_DEVICE inline std::uint64_t fault_word(std::uint32_t frame, std::uint32_t id, FaultKind kind) {
  return (std::uint64_t(frame & 0xFFFFFFu) << 40) | (std::uint64_t(id) << 8) | std::uint64_t(kind);
}
FC_HOST_DEVICE inline std::uint32_t fault_frame(std::uint64_t fault) { return static_cast<std::uint32_t>(fault >> 40); }

// Hashes that the tables of what rough contacts remember should have: see stages/contact_memory.hpp.
struct WantedHashes {
  std::uint64_t soon = 0;  // as there are more than half as many entries
  std::uint64_t now = 0;   // as there was no place for some entry
};

// What a run is watched for, from all spheres at once and in no order.
struct Watch {
  // Of spheres that flew farther than their radius in one step, added up over the steps. Several, as threads would wait
  // for each other at one.
  struct alignas(32) Tally {
    std::uint64_t spheres = 0;
    std::uint64_t longest_flight = 0;  // in radii of the sphere: the bits of a float
  };
  static constexpr std::uint32_t tally_count = 64;

  std::uint64_t first_fault = no_fault;
  Tally tallies[tally_count];
  WantedHashes memory_wanted;
};

// What became of a run: it may have ended before all its frames.
struct RunResult {
  Watch watch;
  std::int64_t frames = 0;
};

// A sphere that flies farther than its radius in one step, from one look at its neighbours to the next, may pass
// through another one unseen.
FC_HOST_DEVICE inline void watch_flight(Watch* watch, std::uint32_t id, Vec3 flight, float radius) {
  if (dot(flight, flight) < 0.999f * (radius * radius)) return;  // most spheres
  const float in_radii = length(flight * (1.0f / radius));
  if (!(in_radii > 1.0f)) return;
  std::uint64_t longest = bits_of(smaller(in_radii, 1e18f)), spheres = 1;
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  // Once for all lanes that are here: in a frame of the report's loop many are.
  const unsigned lanes = __activemask();
  longest = __reduce_max_sync(lanes, static_cast<unsigned>(longest));
  spheres = static_cast<unsigned>(__popc(lanes));
  if (static_cast<int>(threadIdx.x % 32) != lowest_bit(lanes)) return;
#endif
  Watch::Tally& tally = watch->tallies[id % Watch::tally_count];
  atomic_add(&tally.spheres, spheres);
  atomic_max(&tally.longest_flight, longest);
}

// What the device tells the host about its lists, and keeps for its next passes.
struct ListControl {
  ListNews news[2];           // in turn: a pass writes one while the other still holds what the pass before has told
  std::uint32_t longest;      // row that was wanted
  std::uint32_t age;          // passes since the lists were made
  std::uint32_t frame, pass;  // done
  std::uint32_t turn;         // of the next pass
  std::uint32_t state_swaps, sorts;
  Watch watch;
};

}  // namespace fastcollide
