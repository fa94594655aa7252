// One iteration of the reference solver: every sphere gathers what its contacts do to it.
#pragma once

#include "../physics/wall.hpp"
#include "level_neighbors.hpp"

namespace fastcollide {

// Sums of the changes of one sphere. The scales bound one change: see fixed_point_for.
struct SolverScales {
  FixedPoint position, velocity;
};

// A displacement is at most the largest diameter. A velocity change may be up to 512 largest radii a frame: far above
// any speed at which a frame still means something.
inline SolverScales solver_scales(float largest_radius, float dt) {
  return {fixed_point_for(2.0f * largest_radius), fixed_point_for(512.0f * largest_radius / dt)};
}

template <class Neighbors, class Output>
struct SolveContacts {
  static constexpr bool gets_help = true;  // for strays: see frame_lists.hpp

  SolverScales scales;
  Box box;
  std::uint32_t frame;
  GridView grid;
  Neighbors neighbors;
  Output output;
  std::uint64_t* first_fault;

  struct Sum {
    ExactSum3 displacement, velocity_change;
    std::uint32_t contacts = 0, out_of_range = 0;

    FC_HOST_DEVICE bool is_empty() const { return contacts == 0; }
    FC_HOST_DEVICE void combine(const Sum& other) {
      add(displacement, other.displacement);
      add(velocity_change, other.velocity_change);
      contacts += other.contacts;
      out_of_range += other.out_of_range;
    }
  };

  template <class Others>
  FC_HOST_DEVICE SolveContacts<Others, Output> with_neighbors(const Others& others) const {
    return {scales, box, frame, grid, others, output, first_fault};
  }

  FC_HOST_DEVICE Sphere load(std::int64_t slot) const { return sphere_in_slot(grid, slot); }
  FC_HOST_DEVICE Sum gather(std::int64_t slot, Lane lane) const { return gather(load(slot), slot, lane); }
  FC_HOST_DEVICE Sum gather(const Sphere& self, std::int64_t slot, Lane lane) const {
    Sum sum;
    if (is_fixed(self.mass)) return sum;
    auto visit = [&](std::int64_t other) {
      const Vec4 there = grid.position_radius[other];
      if (!overlaps(self.position, self.radius, {there.x, there.y, there.z}, there.w, grid.period)) return;
      const ContactChange change = resolve_contact(self, sphere_in_slot(grid, other), grid.period);
      if (!add_exactly(sum.displacement, change.position, scales.position)) ++sum.out_of_range;
      if (!add_exactly(sum.velocity_change, change.velocity, scales.velocity)) ++sum.out_of_range;
      ++sum.contacts;
    };
    neighbors.visit(grid, slot, self.position, lane, visit);
    return sum;
  }

  FC_HOST_DEVICE void finish(std::int64_t slot, const Sum& sum) const { finish(load(slot), slot, sum); }
  FC_HOST_DEVICE void finish(const Sphere& self, std::int64_t slot, const Sum& sum) const {
    if (sum.out_of_range > 0) atomic_min(first_fault, fault_word(frame, self.id, FaultKind::out_of_range));
    if (sum.contacts > max_terms) atomic_min(first_fault, fault_word(frame, self.id, FaultKind::too_many_contacts));
    const Vec3 moved = self.position + value_of(sum.displacement, scales.position);
    if (!is_in_reach(moved, self.radius, box)) {
      atomic_min(first_fault, fault_word(frame, self.id, FaultKind::out_of_reach));
    }
    output.write(slot, self, place_in_box(moved, self.radius, self.mass, box),
                 self.velocity + value_of(sum.velocity_change, scales.velocity), spin_in_slot(grid, slot));
  }

  FC_HOST_DEVICE void operator()(std::int64_t slot) const { run_alone(*this, slot); }
};

template <Backend B>
void solve_contacts(B& backend, const SolverScales& scales, const Box& box, std::uint32_t frame, const Grid<B>& grid,
                    Bodies<B>& bodies, std::uint64_t* first_fault) {
  const ToBodies output{bodies.positions.data(), bodies.velocities.data(), nullptr, nullptr};
  backend.for_each(bodies.count(), SolveContacts<CellNeighbors, ToBodies>{scales, box, frame, view_of(grid),
                                                                          neighbors_in(grid), output, first_fault});
}

}  // namespace fastcollide
