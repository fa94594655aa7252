// How the work on one sphere is shared.
#pragma once

#include <cstdint>

#include "../math.hpp"

namespace fastcollide {

// Several lanes of a GPU may share the work on one sphere; each does its part.
struct Lane {
  int index = 0, count = 1;
};

// Lanes of a warp that come here at the same time, and from then on go in step as far as they ask each other.
struct LanesTogether {
#if defined(__CUDA_ARCH__)
  unsigned lanes = __activemask();
#endif

  // Whoever else comes here now: all lanes of the warp will.
  FC_HOST_DEVICE static LanesTogether of_warp() {
    LanesTogether together;
#if defined(__CUDA_ARCH__)
    together.lanes = 0xFFFFFFFFu;
#endif
    return together;
  }

  FC_HOST_DEVICE bool any(bool is_so) const {
#if defined(__CUDA_ARCH__)
    return __any_sync(lanes, is_so) != 0;
#else
    return is_so;
#endif
  }
};

// Slots that lie one after the other, and how many lanes each is worth: 1, 8, 32 or a multiple of 128.
struct SlotGroup {
  std::int64_t first, count;
  int lanes;
};

struct SlotGroups {
  static constexpr int most = 16;
  SlotGroup groups[most];  // those worth most lanes first
  int count;
};

inline constexpr std::uint32_t no_slot = ~std::uint32_t(0);

}  // namespace fastcollide
