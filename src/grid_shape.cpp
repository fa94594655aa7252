#include "grid_shape.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "data.hpp"
#include "text.hpp"

namespace fastcollide {
namespace {

std::array<double, 3> extent_of(const Box& box) {
  return {double(box.upper.x) - box.lower.x, double(box.upper.y) - box.lower.y, double(box.upper.z) - box.lower.z};
}

}  // namespace

RadiusRange allowed_radii(const WorldOptions& options) {
  float far = 0, smallest_extent = options.upper[0] - options.lower[0];
  for (int axis = 0; axis < 3; ++axis) {
    far = std::max({far, std::fabs(options.lower[axis]), std::fabs(options.upper[axis])});
    smallest_extent = std::min(smallest_extent, options.upper[axis] - options.lower[axis]);
  }
  const float spacing = std::ldexp(1.0f, std::ilogb(far) - 23);
  return {std::max(64.0f * spacing, 1e-15f), 0.5f * smallest_extent};
}

double smallest_cell_edge(const Box& box, float largest_radius) {
  // cell_coordinate() rounds three times, so a coordinate of up to n cells is off by at most 3 n 2^-24, the difference
  // of two by twice that. Adjacent cells are certain when diameter / edge + n 2^-21 <= 1.
  const double diameter = 2.0 * largest_radius;
  const std::array<double, 3> extent = extent_of(box);
  const double cells = *std::max_element(extent.begin(), extent.end()) / diameter + 1.0;
  return diameter / (1.0 - cells * 0x1p-21);
}

GridShape choose_grid_shape(const Box& box, float largest_radius, float cell_size, std::int64_t count) {
  if (cell_size > 0 && cell_size < 2 * largest_radius) {
    throw InvalidValue(
        "cell_size", -1, text_of(cell_size),
        "at least the largest diameter, " + text_of(2 * largest_radius) + " m: smaller cells would miss contacts");
  }
  // Far more cells than spheres cost time and memory and find nothing. At least 2^18 cost nothing; 2^31 is the most
  // that a hash can number.
  const double most_cells = std::clamp(4.0 * static_cast<double>(count), 262144.0, 2147483647.0);
  const std::array<double, 3> extent = extent_of(box);
  double edge = std::max(smallest_cell_edge(box, largest_radius), static_cast<double>(cell_size));
  std::array<double, 3> cells{};
  for (;;) {
    for (int axis = 0; axis < 3; ++axis) cells[axis] = std::max(1.0, std::ceil(extent[axis] / edge));
    if (cells[0] * cells[1] * cells[2] <= most_cells) break;
    edge *= 1.05;
  }
  return {box.lower, static_cast<float>(1.0 / edge), {int(cells[0]), int(cells[1]), int(cells[2])}};
}

void refuse_value(const WorldOptions& options, Field field, std::int64_t id, const float* found) {
  const RadiusRange radii = allowed_radii(options);
  const auto three = [found] {
    return "(" + text_of(found[0]) + ", " + text_of(found[1]) + ", " + text_of(found[2]) + ")";
  };
  switch (field) {
    case Field::position:
      throw InvalidValue("position", id, three(), "finite numbers [m]");
    case Field::velocity:
      throw InvalidValue("velocity", id, three(), "finite numbers [m/s]");
    case Field::radius:
      throw InvalidValue("radius", id, text_of(found[0]),
                         text_of(radii.smallest) + " to " + text_of(radii.largest) +
                             " m in this box (a sphere must fit in, and float32 must resolve its place)");
    case Field::mass:
      throw InvalidValue("mass", id, text_of(found[0]), "more than 0, up to 1e38 [kg]");
    case Field::restitution:
      break;
  }
  throw InvalidValue("restitution", id, text_of(found[0]), "0 to 1");
}

void refuse_fault(std::uint64_t fault, std::int64_t frame) {
  const std::string where =
      "sphere " + std::to_string((fault >> 8) & 0xFFFFFFFFu) + " in frame " + std::to_string(frame) + ": ";
  switch (FaultKind(fault & 0xFF)) {
    case FaultKind::not_finite:
      throw SimulationError(where + "position or velocity is no longer a finite number");
    case FaultKind::out_of_range:
      throw SimulationError(where +
                            "one contact changes its velocity by more than 512 radii of the largest sphere a frame; "
                            "use a smaller dt, or fewer overlaps at the start");
    case FaultKind::too_many_contacts:
      break;
  }
  throw SimulationError(where + "more than " + std::to_string(max_terms) + " contacts on one sphere");
}

}  // namespace fastcollide
