// The inner loop of the search on a CPU: one sphere against runs of others that lie side by side in memory.
//
// Phase one, here: a run's spheres are compared in single precision (in double for float64 input), as many at once as
// the processor can, and the hits are packed without a branch. The few whose answer the rounding could change are
// decided in double precision. So every form gives the hits of is_within_reach(), in the same order.
#pragma once

#include "reach.hpp"

namespace fastcollide::search {

// Compare `query` with the slots [begin, end), seen from one of its images.
struct Run {
  std::uint32_t query, begin, end;
  std::int32_t image;
};

// Arrays of slots can be read up to this many places past their end.
inline constexpr std::int64_t slot_padding = 16;

template <class T>
struct FilterInput {
  const T *query_x, *query_y, *query_z, *query_radii;  // radii: or null
  const T *x, *y, *z, *radii;                          // of the slots
  Reach reach;
};

// Writes query and slot of each hit; there must be room for all slots of the runs and slot_padding more. Returns their
// number.
template <class T>
using FilterRuns = std::int64_t (*)(const FilterInput<T>& input, const Run* runs, int run_count,
                                    std::uint32_t* hit_queries, std::uint32_t* hit_slots);

enum class Simd : std::uint8_t { none, avx2, avx512 };

// The widest that this processor has, or `FASTCOLLIDE_SIMD` ("none", "avx2", "avx512") where that is less.
Simd best_simd();

template <class T>
FilterRuns<T> filter_runs(Simd simd);

}  // namespace fastcollide::search
