#pragma once

#include <cstdint>

namespace fastcollide {

// What happens where an axis ends. An open axis has no end.
enum class Boundary : std::uint8_t { wall, periodic, open };

}  // namespace fastcollide
