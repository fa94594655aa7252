#include "grid_shape.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "data.hpp"
#include "search/choose_grid.hpp"
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

namespace {

// Narrow along the row, so that a search looks at little else, and wide across, so that it begins few rows. In the
// largest radius of the level.
constexpr double narrow_edge = 1.5, wide_edge = 2.25;
// For each sphere of a level. With 4, heaps had many far cells with the same number; see docs/performance.md.
constexpr double most_level_cells = 32.0;

// Sum of r³, with the sizes in the middle of the octaves.
double cubes_of(const RadiusSurvey& radii) {
  double sum = 0;
  for (int i = 0; i < octaves; ++i) {
    sum += static_cast<double>(radii.octave_counts[i]) * std::pow(0.75 * std::ldexp(radii.largest, -i), 3.0);
  }
  return sum;
}

// Cells as wide as that; where an axis has more of them than `most_cells` allow, far ones share a number, as along an
// open axis: wider ones would be crowded where the spheres lie together.
GridShape choose_level_shape(const Box& box, double largest_radius, double most_cells) {
  const std::array<Axis, 3> axes = axes_of(box);
  std::array<double, 3> all{}, cells{};
  for (std::size_t i = 0; i < 3; ++i) {
    const double fitting = axes[i].extent() / ((i == 0 ? narrow_edge : wide_edge) * largest_radius);
    all[i] = axes[i].boundary == Boundary::wall       ? std::max(1.0, std::ceil(fitting))
             : axes[i].boundary == Boundary::periodic ? std::max(1.0, std::floor(fitting))
                                                      : 1e9;
    cells[i] = all[i];
  }
  while (cells[0] * cells[1] * cells[2] > most_cells) {
    double& longest = *std::max_element(cells.begin(), cells.end());
    longest = std::ceil(0.5 * longest);
  }
  const auto grid_axis = [&](std::size_t i) {
    const bool goes_round = cells[i] < all[i];
    double inverse = 1.0 / ((i == 0 ? narrow_edge : wide_edge) * largest_radius);
    // Round a periodic axis a whole number of times.
    if (axes[i].boundary == Boundary::periodic) inverse = std::floor(all[i] / cells[i]) * cells[i] / axes[i].extent();
    const double origin = axes[i].boundary == Boundary::open ? 0.0 : axes[i].lower;
    return GridAxis{static_cast<float>(origin), static_cast<float>(inverse), static_cast<int>(cells[i]),
                    goes_round ? Boundary::open : axes[i].boundary};
  };
  return {grid_axis(0), grid_axis(1), grid_axis(2)};
}

}  // namespace

double size_spread(const RadiusSurvey& radii) {
  double count = 0;
  for (const std::int64_t spheres : radii.octave_counts) count += static_cast<double>(spheres);
  return count * std::pow(radii.largest, 3.0) / cubes_of(radii);
}

CellLevels one_level(const GridShape& shape) {
  CellLevels levels{};
  levels.count = 1;
  levels.levels[0].shape = shape;
  levels.cells = static_cast<std::uint32_t>(shape.x.cells * shape.y.cells * shape.z.cells);
  return levels;
}

CellLevels choose_levels(const Box& box, const RadiusSurvey& radii, std::int64_t count, float margin) {
  search::Population set{};
  set.count = count;
  set.largest_size = radii.largest;
  // As if all lay in a heap: the box may be far larger.
  std::copy(std::begin(radii.octave_counts), std::end(radii.octave_counts), set.octave_counts.begin());
  for (double& end : set.high) end = std::cbrt(4.19 / 0.5 * cubes_of(radii));
  CellLevels levels{};
  levels.largest_exponent = exponent_of(radii.largest);
  levels.margin = margin;
  const std::array<int, octaves> firsts = search::first_octaves(set, {narrow_edge, wide_edge}, levels.count);
  for (int k = 0; k < levels.count; ++k) {
    const int begin = firsts[static_cast<std::size_t>(k)];
    const int end = k + 1 < levels.count ? firsts[static_cast<std::size_t>(k) + 1] : octaves;
    std::int64_t members = 0;
    for (int octave = begin; octave < end; ++octave) {
      members += radii.octave_counts[octave];
      levels.level_of_octave[octave] = static_cast<std::uint8_t>(k);
    }
    CellLevel& level = levels.levels[k];
    // Octaves end at powers of two; the first one has the largest sphere.
    level.largest_radius = begin == 0 ? radii.largest : std::ldexp(1.0f, levels.largest_exponent - 127 - begin + 1);
    level.shape = choose_level_shape(box, level.largest_radius,
                                     std::clamp(most_level_cells * static_cast<double>(members), 4096.0, 0x1p27));
    level.first_cell = levels.cells;
    levels.cells += static_cast<std::uint32_t>(level.shape.x.cells * level.shape.y.cells * level.shape.z.cells);
  }
  return levels;
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
