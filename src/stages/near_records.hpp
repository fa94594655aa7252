// In flight most spheres have nobody near. To find that out takes little of each, and so few registers that a GPU has
// twice as many of them at work; the contact pass, which needs many, then takes the others alone and looks no further.
#pragma once

#include "contact_terms.hpp"
#include "frame_lists.hpp"

namespace fastcollide {

// Finds who is near a sphere. Where nobody is, it writes what a contact pass would.
struct FindNear {
  GridView grid;
  FrameListNeighbors neighbors;
  Box box;
  Flight flight;
  float nearest_wall;  // depth in a wall that is far enough from it [m]
  float* crowding;
  std::uint32_t* pick;
  std::uint32_t pass;
  FrameControl* control;

  FC_HOST_DEVICE void assume_walls() {
    grid.period = {0, 0, 0};
    fastcollide::assume_walls(box);
    neighbors.assume_walls();
  }
  FC_HOST_DEVICE std::uint32_t* record_counts() const { return control->near_records[pass % 2]; }

  // True where a contact may count: then near(0) to near(count - 1) are with whom.
  template <class Near>
  FC_HOST_DEVICE bool operator()(std::int64_t slot, std::uint32_t& count, const Near& near) const {
    if (slot == 0) {
      for (std::uint32_t& next : control->near_records[(pass + 1) % 2]) next = 0;
    }
    const Vec4 self = grid.position_radius[slot];
    count = 0;
    const bool is_free = !is_fixed(grid.mass_ids[slot].mass);
    if (is_free) count = neighbors.find_near(grid, slot, self, near);
    if (count > 0 && count != NearRecord::unknown) count = keep_meeting(slot, count, near);
    if (count > 0 || !is_free || deepest_in_walls({self.x, self.y, self.z}, self.w, box) > nearest_wall) return true;
    crowding[slot] = -0.0f;
    pick[slot] = pick_of_untouched;
    return false;
  }

  template <class Near>
  FC_HOST_DEVICE std::uint32_t keep_meeting(std::int64_t slot, std::uint32_t count, const Near& near) const {
    const Sphere self = falling_sphere_in_slot(grid, slot, flight);
    std::uint32_t kept = 0;
    for (std::uint32_t k = 0; k < count; ++k) {
      const std::uint32_t other = near(k);
      if (may_count(self, falling_sphere_in_slot(grid, other, flight), grid.period, flight.dt)) near(kept++) = other;
    }
    return kept;
  }
};

// What the contact pass looks at: who was found.
struct NearNeighbors : FrameListNeighbors {
  const std::uint32_t* near = nullptr;
  std::uint32_t count = NearRecord::unknown;

  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, Visit& visit) const {
    if (count == NearRecord::unknown) return FrameListNeighbors::visit(grid, slot, position, lane, visit);
    for (auto k = static_cast<std::uint32_t>(lane.index); k < count; k += static_cast<std::uint32_t>(lane.count)) {
      visit(near[k]);
    }
  }
};

}  // namespace fastcollide
