#include "format_frame.hpp"

#include <charconv>

namespace fastcollide {
namespace {

template <class Number>
void append(std::string& text, Number number, char after) {
  char digits[40];
  const std::to_chars_result result = std::to_chars(digits, digits + sizeof digits, number);
  text.append(digits, result.ptr);
  text.push_back(after);
}

}  // namespace

std::string format_frame(std::int64_t frame, double time, std::int64_t count, const float* positions,
                         const float* radii) {
  std::string text;
  text.reserve(static_cast<std::size_t>(128 + 56 * count));
  text += "# FastCollide frame, format 1\n# frame: ";
  append(text, frame, '\n');
  text += "# time: ";
  append(text, time, ' ');
  text += "s\n# count: ";
  append(text, count, '\n');
  text += "# columns: id x[m] y[m] z[m] radius[m]\n";
  for (std::int64_t i = 0; i < count; ++i) {
    append(text, i, ' ');
    for (int axis = 0; axis < 3; ++axis) append(text, positions[3 * i + axis], ' ');
    append(text, radii[i], '\n');
  }
  return text;
}

}  // namespace fastcollide
