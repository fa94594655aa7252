// The search on a CPU: spheres in cell order, so that what lies side by side in space lies side by side in memory.
//
//   search_slots<T>(best_simd())(input, begin, end, sink)
//
// finds for each sphere in the slots [begin, end) those within reach and gives the sink some of them at a time. In one
// set each pair is found once: from the smaller of two levels, or the earlier slot. Slots can be cut among threads in
// any way. It takes plain pointers: whoever has spheres in cell order can call it.
#pragma once

#include "search_grid.hpp"

namespace fastcollide::search {

// Arrays of slots can be read up to this many places past their end.
inline constexpr std::int64_t slot_padding = 16;

// Spheres in cell order; a slot is a place in that order. y, z and, if there are any, radii lie `stride` elements,
// twice and three times as many behind x.
template <class T>
struct Slots {
  const T* x;
  std::int64_t stride;
  bool has_radii;
  const std::uint32_t* ids;

  Point<T> position(std::int64_t slot) const { return {x[slot], x[slot + stride], x[slot + 2 * stride]}; }
  T radius(std::int64_t slot) const { return has_radii ? x[slot + 3 * stride] : T(0); }
};

// What is compared with what. Both sets have radii, or none.
template <class T>
struct Compared {
  Slots<T> searchers, targets;
  Reach reach;
};

template <class T>
struct SlotSearch {
  SearchGrid<T> grid;
  const std::uint32_t* cell_start;  // one more than cells
  Compared<T> sets;                 // twice the same where there is one
  bool is_one_set;
};

// Takes `count` hits: the ids of the sphere that searched and of the one that it found.
struct HitSink {
  void* context;
  void (*take)(void* context, std::int64_t count, const std::uint32_t* searchers, const std::uint32_t* found);
};

template <class T>
using SearchSlots = void (*)(const SlotSearch<T>& input, std::int64_t begin, std::int64_t end, HitSink sink);

enum class Simd : std::uint8_t { none, avx2, avx512 };

// The widest that this processor has, or `FASTCOLLIDE_SIMD` ("none", "avx2", "avx512") where that is less.
Simd best_simd();

template <class T>
SearchSlots<T> search_slots(Simd simd);

}  // namespace fastcollide::search
