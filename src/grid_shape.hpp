// Choices made on the host: the grid for a world, the radii that a box allows, and errors for what breaks them.
#pragma once

#include "fastcollide/world.hpp"
#include "physics/levels.hpp"
#include "stages/check_state.hpp"

namespace fastcollide {

Box box_of(const WorldOptions& options);

struct RadiusRange {
  float smallest, largest;  // [m]
};

// A sphere must fit into the box, and float32 must place it: the spacing of numbers at the far end of the box may be at
// most 1/64 of the smallest radius (at that limit about one contact in a thousand is decided by the rounding of the
// positions).
RadiusRange allowed_radii(const Box& box);

// Smallest edge of a cell for which two spheres that overlap always lie in the same or in adjacent cells, after the
// rounding of cell_coordinate() [m].
double smallest_cell_edge(const Box& box, float largest_radius);

// Edges as small as that, or as asked for if larger; larger still where the box would need far more cells than there
// are spheres.
// margin: how far apart two surfaces may be that still have to be found [m].
GridShape choose_grid_shape(const Box& box, float largest_radius, float cell_size, std::int64_t count,
                            float margin = 0);

// Spheres by size: how many are in each octave below the largest.
struct RadiusSurvey {
  float largest;
  std::int64_t octave_counts[octaves];
};

// r_max³ / ⟨r³⟩, from the sizes in the middle of the octaves: in a dense heap, how many spheres lie in a cell that
// suits the largest.
double size_spread(const RadiusSurvey& radii);

// Beyond this, grids in levels: on a GPU, where long lists keep a lane waiting, sooner.
inline constexpr double widest_spread_on_cpu = 1000, widest_spread_on_gpu = 40;

// Cells for all spheres.
CellLevels one_level(const GridShape& shape);

// Levels for the least expected time; one where the sizes differ little.
CellLevels choose_levels(const Box& box, const RadiusSurvey& radii, std::int64_t count, float margin);

// Throws the InvalidValue for sphere `id`, of which `found` holds the value.
[[noreturn]] void refuse_value(const Box& box, Field field, std::int64_t id, const float* found);

// Throws the SimulationError for a fault word; `frame` is the number of the frame that failed.
[[noreturn]] void refuse_fault(std::uint64_t fault, std::int64_t frame);

}  // namespace fastcollide
