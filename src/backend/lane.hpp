// How the work on one sphere is shared.
#pragma once

#include <cstdint>

#include "../math.hpp"

namespace fastcollide {

// Several lanes of a GPU may share the work on one sphere; each does its part.
struct Lane {
  int index = 0, count = 1;
};

inline constexpr std::uint32_t no_slot = ~std::uint32_t(0);

}  // namespace fastcollide
