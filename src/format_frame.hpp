// The text of one exported frame.
#pragma once

#include <cstdint>
#include <string>

namespace fastcollide {

// A header of lines that start with '#', then "id x y z radius" for each sphere, each number with the fewest digits
// that give the same float32 again. positions has 3 * count values.
std::string format_frame(std::int64_t frame, double time, std::int64_t count, const float* positions,
                         const float* radii);

}  // namespace fastcollide
