// Numbers in messages.
#pragma once

#include <cstdio>
#include <string>

namespace fastcollide {

// As many digits as float32 needs, without trailing zeros.
inline std::string text_of(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.9g", value);
  return text;
}

}  // namespace fastcollide
