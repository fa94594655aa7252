// How crowded each sphere is, where no substep before has told.
#pragma once

#include "level_neighbors.hpp"
#include "substep_scratch.hpp"

namespace fastcollide {

struct MeasureCrowding {
  SoftContactLaw law;
  Box box;
  GridView grid;
  CellNeighbors neighbors;
  float* crowding;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const Sphere self = sphere_in_slot(grid, slot);
    if (is_fixed(self.mass)) {
      crowding[self.id] = 0.0f;  // nothing that is done to it has to be cut
      return;
    }
    CrowdingSum sum;
    auto visit = [&](std::int64_t other) {
      if (!is_near(self, grid, other, law.opening_margin)) return;
      const Sphere neighbor = sphere_in_slot(grid, other);
      const PairGeometry pair = pair_geometry(self, neighbor, grid.period);
      if (pair.contact.depth <= 0.0f || pair.normal_velocity < -law.impact_speed) return;
      const float weight = mass_weight(self.mass, neighbor.mass) * load_weight_in(grid, pair.contact.depth, law);
      add_contact(sum, pair.contact.normal, weight);
    };
    neighbors.visit(grid, slot, self.position, Lane{}, visit);
    auto visit_wall = [&](Vec3 normal, float depth, int) {
      if (depth <= 0.0f || dot(self.velocity, normal) < -law.impact_speed) return;
      add_contact(sum, normal, load_weight_in(grid, depth, law));
    };
    visit_walls(self.position, self.radius, box, visit_wall);
    crowding[self.id] = crowding_of(sum);
  }
};

template <Backend B>
void measure_crowding(B& backend, const SoftContactLaw& law, const Box& box, const Grid<B>& grid,
                      SubstepScratch<B>& scratch) {
  const std::int64_t count = grid.ids.size();
  scratch.crowding.resize(count);
  if (law.gravity == 0.0f) return backend.fill_zero(scratch.crowding.data(), count);
  backend.for_each(count, MeasureCrowding{law, box, view_of(grid), neighbors_in(grid), scratch.crowding.data()});
}

}  // namespace fastcollide
