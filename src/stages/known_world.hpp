// Where a compiler is told what a world does not have, it leaves out all that belongs to it.
#pragma once

#include "frame_lists.hpp"

namespace fastcollide {

template <bool is_rough, bool has_walls, class Pass>
FC_HOST_DEVICE Pass in_known_world(Pass pass) {
  if constexpr (!is_rough) {
    pass.grid.spins = nullptr;
    pass.grid.frictions = nullptr;
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

}  // namespace fastcollide
