// One iteration of the reference solver: every sphere gathers what its contacts do to it.
#pragma once

#include "../data.hpp"
#include "../physics/wall.hpp"

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

struct SolveContacts {
  SolverScales scales;
  Box box;
  std::uint32_t frame;
  GridView grid;
  Vec3* positions;
  Vec3* velocities;
  std::uint64_t* first_fault;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const Sphere self = sphere_in_slot(grid, slot);
    ExactSum3 displacement, velocity_change;
    std::int64_t contacts = 0;
    bool in_range = true;
    auto visit = [&](std::int64_t other) {
      const Vec4 there = grid.position_radius[other];
      if (!overlaps(self.position, self.radius, {there.x, there.y, there.z}, there.w, grid.period)) return;
      const ContactChange change = resolve_contact(self, sphere_in_slot(grid, other), grid.period);
      in_range = add_exactly(displacement, change.position, scales.position) && in_range;
      in_range = add_exactly(velocity_change, change.velocity, scales.velocity) && in_range;
      ++contacts;
    };
    visit_neighbor_cells(grid, slot, self.position, visit);

    if (!in_range) atomic_min(first_fault, fault_word(frame, self.id, FaultKind::out_of_range));
    if (contacts > max_terms) atomic_min(first_fault, fault_word(frame, self.id, FaultKind::too_many_contacts));
    const Vec3 moved = self.position + value_of(displacement, scales.position);
    if (!is_in_reach(moved, self.radius, box)) {
      atomic_min(first_fault, fault_word(frame, self.id, FaultKind::out_of_reach));
    }
    positions[self.id] = keep_inside(moved, self.radius, box);
    velocities[self.id] = self.velocity + value_of(velocity_change, scales.velocity);
  }
};

template <Backend B>
void solve_contacts(B& backend, const SolverScales& scales, const Box& box, std::uint32_t frame, const Grid<B>& grid,
                    Bodies<B>& bodies, std::uint64_t* first_fault) {
  backend.for_each(bodies.count(), SolveContacts{scales, box, frame, view_of(grid), bodies.positions.data(),
                                                 bodies.velocities.data(), first_fault});
}

}  // namespace fastcollide
