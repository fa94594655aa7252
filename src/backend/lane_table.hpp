// How to move some of 8 vector lanes to the front.
#pragma once

#include <cstdint>

namespace fastcollide {

// For each set of 8 lanes, its members in order, one in each byte.
struct LaneTable {
  std::uint64_t lanes[256];
  constexpr LaneTable() : lanes() {
    for (int set = 0; set < 256; ++set) {
      int place = 0;
      for (int lane = 0; lane < 8; ++lane) {
        if ((set >> lane & 1) != 0) lanes[set] |= std::uint64_t(lane) << (8 * place++);
      }
    }
  }
};
inline constexpr LaneTable lane_table;

}  // namespace fastcollide
