#include "grid_shape.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "data.hpp"
#include "text.hpp"

namespace fastcollide {
namespace {

struct Axis {
  double lower, upper;
  Boundary boundary;
  double extent() const { return upper - lower; }
};

std::array<Axis, 3> axes_of(const Box& box) {
  return {Axis{box.lower.x, box.upper.x, box.x}, Axis{box.lower.y, box.upper.y, box.y},
          Axis{box.lower.z, box.upper.z, box.z}};
}

}  // namespace

Box box_of(const WorldOptions& options) {
  const auto& [x, y, z] = options.boundary;
  return {{options.lower[0], options.lower[1], options.lower[2]},
          {options.upper[0], options.upper[1], options.upper[2]},
          x,
          y,
          z};
}

RadiusRange allowed_radii(const Box& box) {
  // A sphere must fit between two walls, and touch no other twice across a periodic end.
  double smallest = 1e-15, largest = 1e15;
  for (const Axis& axis : axes_of(box)) {
    if (axis.boundary == Boundary::open) continue;
    const double far = std::max(std::fabs(axis.lower), std::fabs(axis.upper));
    smallest = std::max(smallest, 64.0 * std::ldexp(1.0, std::ilogb(far) - 23));
    largest = std::min(largest, axis.extent() * (axis.boundary == Boundary::wall ? 0.5 : 0.25));
  }
  return {static_cast<float>(smallest), static_cast<float>(largest)};
}

double smallest_cell_edge(const Box& box, float largest_radius) {
  // cell_coordinate() rounds three times, so a coordinate of up to n cells is off by at most 3 n 2^-24, the difference
  // of two by twice that. Adjacent cells are certain when diameter / edge + n 2^-21 <= 1.
  const double diameter = 2.0 * largest_radius;
  double cells = 1.0;
  for (const Axis& axis : axes_of(box)) {
    const bool is_open = axis.boundary == Boundary::open;
    cells = std::max(cells, 1.0 + (is_open ? 0.5 * reach_in_radii : axis.extent() / diameter));
  }
  return diameter / (1.0 - cells * 0x1p-21);
}

GridShape choose_grid_shape(const Box& box, float largest_radius, float cell_size, std::int64_t count, float margin) {
  if (cell_size > 0 && cell_size < 2 * largest_radius) {
    throw InvalidValue(
        "cell_size", -1, text_of(cell_size),
        "at least the largest diameter, " + text_of(2 * largest_radius) + " m: smaller cells would miss contacts");
  }
  // Far more cells than spheres cost time and memory and find nothing. At least 2^18 cost nothing; 2^31 is the most
  // that a hash can number.
  const double most_cells = std::clamp(4.0 * static_cast<double>(count), 262144.0, 2147483647.0);
  const std::array<Axis, 3> axes = axes_of(box);
  double edge = std::max(smallest_cell_edge(box, largest_radius + 0.5f * margin), static_cast<double>(cell_size));
  std::array<double, 3> cells{};
  const auto count_cells = [&](double open_cells) {
    for (std::size_t i = 0; i < 3; ++i) {
      // Between walls the last cell may be cut; round a periodic axis whole cells must fit.
      const double fitting = axes[i].extent() / edge;
      cells[i] = axes[i].boundary == Boundary::wall       ? std::max(1.0, std::ceil(fitting))
                 : axes[i].boundary == Boundary::periodic ? std::max(1.0, std::floor(fitting))
                                                          : open_cells;
    }
    return cells[0] * cells[1] * cells[2];
  };
  while (count_cells(3.0) > most_cells) edge *= 1.05;
  // Open axes share what the others leave; more cells, less often two far ones with the same number.
  double open_cells = 3.0;
  while (open_cells < 512.0 && count_cells(2.0 * open_cells) <= most_cells) open_cells *= 2.0;
  count_cells(open_cells);
  const auto grid_axis = [&](std::size_t i) {
    const double inverse = axes[i].boundary == Boundary::periodic ? cells[i] / axes[i].extent() : 1.0 / edge;
    const double origin = axes[i].boundary == Boundary::open ? 0.0 : axes[i].lower;
    return GridAxis{static_cast<float>(origin), static_cast<float>(inverse), static_cast<int>(cells[i]),
                    axes[i].boundary};
  };
  return {grid_axis(0), grid_axis(1), grid_axis(2)};
}

void refuse_value(const Box& box, Field field, std::int64_t id, const float* found) {
  const RadiusRange radii = allowed_radii(box);
  const auto three = [found] {
    return "(" + text_of(found[0]) + ", " + text_of(found[1]) + ", " + text_of(found[2]) + ")";
  };
  switch (field) {
    case Field::position:
      throw InvalidValue("position", id, three(),
                         "finite numbers; along an open axis up to 131072 radii from 0, where float32 still resolves "
                         "the place of a sphere [m]");
    case Field::velocity:
      throw InvalidValue("velocity", id, three(), "finite numbers [m/s]");
    case Field::radius:
      throw InvalidValue("radius", id, text_of(found[0]),
                         text_of(radii.smallest) + " to " + text_of(radii.largest) +
                             " m in this box (a sphere must fit in, and float32 must resolve its place)");
    case Field::mass:
      throw InvalidValue("mass", id, text_of(found[0]), "more than 0, up to 1e38, or infinite for a fixed sphere [kg]");
    case Field::spin:
      throw InvalidValue("spin", id, three(), "finite numbers [rad/s]");
    case Field::friction:
      throw InvalidValue("friction", id, text_of(found[0]), "0 to 1e6");
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
    case FaultKind::out_of_reach:
      throw SimulationError(where +
                            "it is more than 131072 radii from 0 along an open axis, where float32 no longer "
                            "resolves its place");
    case FaultKind::too_many_contacts:
    case FaultKind::memory_full:  // never told: the run is done again
      break;
  }
  throw SimulationError(where + "more than " + std::to_string(max_terms) + " contacts on one sphere");
}

}  // namespace fastcollide
