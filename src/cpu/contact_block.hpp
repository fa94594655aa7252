// Contacts side by side, as the vector units of a CPU take them.
#pragma once

#include <optional>

#include "../search/slot_search.hpp"
#include "../stages/contact_terms.hpp"

namespace fastcollide {

struct ContactBlock {
  static constexpr int size = 256;
  static constexpr int room = size + 8;  // vectors may be written up to their end
  using Numbers = float[room];
  using Words = std::uint32_t[room];
  using Exact = decltype(ExactSum3::x);

  // As slots hold them: without the gravity and drag of this substep in their velocities.
  struct Side {
    Numbers x, y, z, radius, velocity_x, velocity_y, velocity_z, mass, crowding;
    Words ids;

    Sphere sphere(int i) const {
      return {{x[i], y[i], z[i]}, radius[i], {velocity_x[i], velocity_y[i], velocity_z[i]}, 0.0f, mass[i], ids[i]};
    }
  };

  Side self, neighbor;
  Words others;  // slots of the neighbours
  // The terms of each, and what they add to the sums of its sphere:
  Numbers normal_x, normal_y, normal_z, depth, push, speed, part, met_at;
  Words is_counted, is_resting, is_impact, out_of_range;
  Exact change_x[room], change_y[room], change_z[room];
  std::int32_t xx[room], yy[room], zz[room], xy[room], xz[room], yz[room];

  ContactGeometry contact(int i) const { return {{normal_x[i], normal_y[i], normal_z[i]}, depth[i]}; }
};

struct BlockFunctions {
  // Puts the spheres of a list that are near one from `place` on, and perhaps some a little beyond. Returns where they
  // end. The list may be read up to the next multiple of 8.
  int (*collect)(const GridView& grid, float margin, std::int64_t slot, const std::uint32_t* list, int listed,
                 int place, ContactBlock& block);
  // Finds the terms of the first `count` contacts.
  void (*find_terms)(const Substep& substep, Vec3 period, bool is_rough, int count, ContactBlock& block);
};

// None where the processor has no vector units that are worth it: spheres are better taken one by one there.
std::optional<BlockFunctions> block_functions(search::Simd simd);

}  // namespace fastcollide
