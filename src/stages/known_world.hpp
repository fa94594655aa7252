// Where a compiler is told what a world does not have, it leaves out all that belongs to it.
#pragma once

#include "frame_lists.hpp"

namespace fastcollide {

template <bool is_rough, bool has_walls, class Pass>
FC_HOST_DEVICE Pass in_known_world(Pass pass) {
  if constexpr (!is_rough) {
    pass.grid.spins = nullptr;
    pass.output.to.spins = nullptr;
    if constexpr (requires { pass.turn; }) pass.turn = nullptr;
    if constexpr (requires { pass.cleared; }) pass.cleared.rows = nullptr;
  }
  if constexpr (has_walls) {
    pass.grid.period = {0, 0, 0};
    pass.output.assume_walls();
    if constexpr (requires { pass.neighbors.assume_walls(); }) pass.neighbors.assume_walls();
    if constexpr (requires { pass.substep; }) {
      assume_walls(pass.substep.box);
    } else {
      assume_walls(pass.box);
    }
  }
  return pass;
}

// Calls call.operator()<is_rough, has_walls>() as the world has them.
template <class Call>
void call_for_world(bool is_rough, const Box& box, const Call& call) {
  const bool has_walls = box.x == Boundary::wall && box.y == Boundary::wall && box.z == Boundary::wall;
  if (is_rough) {
    has_walls ? call.template operator()<true, true>() : call.template operator()<true, false>();
  } else {
    has_walls ? call.template operator()<false, true>() : call.template operator()<false, false>();
  }
}

}  // namespace fastcollide
