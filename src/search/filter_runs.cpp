#include "filter_runs.hpp"

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <cstring>
#include <type_traits>

#if defined(__x86_64__) && defined(__GNUC__)
#define FC_HAS_X86_SIMD 1
#include <immintrin.h>
#else
#define FC_HAS_X86_SIMD 0
#endif

namespace fastcollide::search {
namespace {

// In single precision d² and (r₁ + r₂ + margin)² are off by less than 12 units of 2^-24 together, relative; across a
// periodic end each difference by up to 2 periods · 2^-24 more, and d² by 2 d times that along each axis.
constexpr float doubt_of_rounding = 0x1p-19f;

float doubt_of_images(const Period& period) { return static_cast<float>((period.x + period.y + period.z) * 0x1p-21); }

template <class T>
bool is_hit(const FilterInput<T>& input, const Run& run, std::uint32_t slot) {
  const std::uint32_t q = run.query;
  return is_within_reach<T>(
      {input.query_x[q], input.query_y[q], input.query_z[q]},
      input.query_radii == nullptr ? T(0) : input.query_radii[q], {input.x[slot], input.y[slot], input.z[slot]},
      input.radii == nullptr ? T(0) : input.radii[slot], input.reach.period.shift(run.image), input.reach);
}

template <class T>
std::int64_t filter_plainly(const FilterInput<T>& input, const Run* runs, int run_count, std::uint32_t* hit_queries,
                            std::uint32_t* hit_slots) {
  std::int64_t hits = 0;
  for (const Run* run = runs; run < runs + run_count; ++run) {
    for (std::uint32_t slot = run->begin; slot < run->end; ++slot) {
      hit_queries[hits] = run->query;
      hit_slots[hits] = slot;
      hits += is_hit(input, *run, slot) ? 1 : 0;
    }
  }
  return hits;
}

#if FC_HAS_X86_SIMD
#define FC_AVX512 __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,bmi,bmi2,popcnt")))
#define FC_AVX2 __attribute__((target("avx2,bmi,bmi2,popcnt")))

// Without the hits among `doubtful` lanes that double precision refuses.
template <class T>
unsigned without_misses(const FilterInput<T>& input, const Run& run, std::uint32_t slot, unsigned hits,
                        unsigned doubtful) {
  for (; doubtful != 0; doubtful &= doubtful - 1) {
    const int lane = std::countr_zero(doubtful);
    if (!is_hit(input, run, slot + static_cast<std::uint32_t>(lane))) hits &= ~(1u << lane);
  }
  return hits;
}

// The lanes of `width` that have a slot left.
FC_AVX2 inline unsigned live_lanes(std::uint32_t slots_left, std::uint32_t width) {
  return (1u << (slots_left < width ? slots_left : width)) - 1u;
}

template <bool has_radii, bool has_images>
FC_AVX512 std::int64_t filter_avx512(const FilterInput<float>& input, const Run* runs, int run_count,
                                     std::uint32_t* hit_queries, std::uint32_t* hit_slots) {
  const __m512 relative_doubt = _mm512_set1_ps(doubt_of_rounding);
  const __m512 image_doubt = _mm512_set1_ps(doubt_of_images(input.reach.period));
  const __m512i lanes = _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0);
  const float margin = static_cast<float>(input.reach.margin);
  std::int64_t hits = 0;
  for (const Run* run = runs; run < runs + run_count; ++run) {
    const std::uint32_t q = run->query;
    const __m512 x = _mm512_set1_ps(input.query_x[q]), y = _mm512_set1_ps(input.query_y[q]),
                 z = _mm512_set1_ps(input.query_z[q]);
    const __m512 size = _mm512_set1_ps((input.query_radii == nullptr ? 0.0f : input.query_radii[q]) + margin);
    const __m512i query = _mm512_set1_epi32(static_cast<int>(q));
    Point<double> shift{};
    if constexpr (has_images) shift = input.reach.period.shift(run->image);
    for (std::uint32_t slot = run->begin; slot < run->end; slot += 16) {
      __m512 dx = _mm512_sub_ps(_mm512_loadu_ps(input.x + slot), x);
      __m512 dy = _mm512_sub_ps(_mm512_loadu_ps(input.y + slot), y);
      __m512 dz = _mm512_sub_ps(_mm512_loadu_ps(input.z + slot), z);
      if constexpr (has_images) {
        dx = _mm512_sub_ps(dx, _mm512_set1_ps(static_cast<float>(shift.x)));
        dy = _mm512_sub_ps(dy, _mm512_set1_ps(static_cast<float>(shift.y)));
        dz = _mm512_sub_ps(dz, _mm512_set1_ps(static_cast<float>(shift.z)));
      }
      const __m512 squared =
          _mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(dx, dx), _mm512_mul_ps(dy, dy)), _mm512_mul_ps(dz, dz));
      __m512 reach = size;
      if constexpr (has_radii) reach = _mm512_add_ps(reach, _mm512_loadu_ps(input.radii + slot));
      const __m512 limit = _mm512_mul_ps(reach, reach);
      __m512 doubt = _mm512_mul_ps(limit, relative_doubt);
      if constexpr (has_images) doubt = _mm512_add_ps(doubt, _mm512_mul_ps(reach, image_doubt));
      const __mmask16 live = static_cast<__mmask16>(live_lanes(run->end - slot, 16));
      __mmask16 found = _mm512_mask_cmp_ps_mask(live, squared, _mm512_add_ps(limit, doubt), _CMP_LE_OQ);
      const __mmask16 doubtful = _mm512_mask_cmp_ps_mask(found, squared, _mm512_sub_ps(limit, doubt), _CMP_GE_OQ);
      if (doubtful != 0) [[unlikely]] {
        found = static_cast<__mmask16>(without_misses(input, *run, slot, found, doubtful));
      }
      const __m512i slots = _mm512_add_epi32(_mm512_set1_epi32(static_cast<int>(slot)), lanes);
      _mm512_storeu_si512(hit_slots + hits, _mm512_maskz_compress_epi32(found, slots));
      _mm512_storeu_si512(hit_queries + hits, query);
      hits += _mm_popcnt_u32(found);
    }
  }
  return hits;
}

template <bool has_radii, bool has_images>
FC_AVX512 std::int64_t filter_avx512(const FilterInput<double>& input, const Run* runs, int run_count,
                                     std::uint32_t* hit_queries, std::uint32_t* hit_slots) {
  const __m256i lanes = _mm256_set_epi32(7, 6, 5, 4, 3, 2, 1, 0);
  const __m512d margin = _mm512_set1_pd(input.reach.margin);
  const __mmask8 on_limit = input.reach.is_inclusive ? 0xFF : 0;
  std::int64_t hits = 0;
  for (const Run* run = runs; run < runs + run_count; ++run) {
    const std::uint32_t q = run->query;
    const __m512d x = _mm512_set1_pd(input.query_x[q]), y = _mm512_set1_pd(input.query_y[q]),
                  z = _mm512_set1_pd(input.query_z[q]);
    const __m512d radius = _mm512_set1_pd(input.query_radii == nullptr ? 0.0 : input.query_radii[q]);
    const __m256i query = _mm256_set1_epi32(static_cast<int>(q));
    Point<double> shift{};
    if constexpr (has_images) shift = input.reach.period.shift(run->image);
    for (std::uint32_t slot = run->begin; slot < run->end; slot += 8) {
      __m512d dx = _mm512_sub_pd(_mm512_loadu_pd(input.x + slot), x);
      __m512d dy = _mm512_sub_pd(_mm512_loadu_pd(input.y + slot), y);
      __m512d dz = _mm512_sub_pd(_mm512_loadu_pd(input.z + slot), z);
      if constexpr (has_images) {
        dx = _mm512_sub_pd(dx, _mm512_set1_pd(shift.x));
        dy = _mm512_sub_pd(dy, _mm512_set1_pd(shift.y));
        dz = _mm512_sub_pd(dz, _mm512_set1_pd(shift.z));
      }
      const __m512d squared =
          _mm512_add_pd(_mm512_add_pd(_mm512_mul_pd(dx, dx), _mm512_mul_pd(dy, dy)), _mm512_mul_pd(dz, dz));
      __m512d reach = radius;
      if constexpr (has_radii) reach = _mm512_add_pd(reach, _mm512_loadu_pd(input.radii + slot));
      reach = _mm512_add_pd(reach, margin);
      const __m512d limit = _mm512_mul_pd(reach, reach);
      const __mmask8 live = static_cast<__mmask8>(live_lanes(run->end - slot, 8));
      const unsigned found = _mm512_mask_cmp_pd_mask(live, squared, limit, _CMP_LT_OQ) |
                             _mm512_mask_cmp_pd_mask(live & on_limit, squared, limit, _CMP_EQ_OQ);
      const __m256i slots = _mm256_add_epi32(_mm256_set1_epi32(static_cast<int>(slot)), lanes);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(hit_slots + hits),
                          _mm256_maskz_compress_epi32(static_cast<__mmask8>(found), slots));
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(hit_queries + hits), query);
      hits += _mm_popcnt_u32(found);
    }
  }
  return hits;
}

// For each set of 8 lanes, its members in order, one in each byte.
struct LaneTable {
  std::uint64_t lanes[256];
  constexpr LaneTable() : lanes() {
    for (int set = 0; set < 256; ++set) {
      int place = 0;
      for (int lane = 0; lane < 8; ++lane) {
        if ((set >> lane & 1) != 0) lanes[set] |= std::uint64_t(lane) << (8 * place++);
      }
    }
  }
};
constexpr LaneTable lane_table;

// Stores first + lane of each lane found, and the query as often; up to 8 places are written.
FC_AVX2 inline int store_hits(unsigned found, std::uint32_t first, std::uint32_t query, std::uint32_t* hit_queries,
                              std::uint32_t* hit_slots) {
  const __m256i lanes = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<long long>(lane_table.lanes[found])));
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(hit_slots),
                      _mm256_add_epi32(_mm256_set1_epi32(static_cast<int>(first)), lanes));
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(hit_queries), _mm256_set1_epi32(static_cast<int>(query)));
  return _mm_popcnt_u32(found);
}

template <bool has_radii, bool has_images>
FC_AVX2 std::int64_t filter_avx2(const FilterInput<float>& input, const Run* runs, int run_count,
                                 std::uint32_t* hit_queries, std::uint32_t* hit_slots) {
  const __m256 relative_doubt = _mm256_set1_ps(doubt_of_rounding);
  const __m256 image_doubt = _mm256_set1_ps(doubt_of_images(input.reach.period));
  const float margin = static_cast<float>(input.reach.margin);
  std::int64_t hits = 0;
  for (const Run* run = runs; run < runs + run_count; ++run) {
    const std::uint32_t q = run->query;
    const __m256 x = _mm256_set1_ps(input.query_x[q]), y = _mm256_set1_ps(input.query_y[q]),
                 z = _mm256_set1_ps(input.query_z[q]);
    const __m256 size = _mm256_set1_ps((input.query_radii == nullptr ? 0.0f : input.query_radii[q]) + margin);
    Point<double> shift{};
    if constexpr (has_images) shift = input.reach.period.shift(run->image);
    for (std::uint32_t slot = run->begin; slot < run->end; slot += 8) {
      __m256 dx = _mm256_sub_ps(_mm256_loadu_ps(input.x + slot), x);
      __m256 dy = _mm256_sub_ps(_mm256_loadu_ps(input.y + slot), y);
      __m256 dz = _mm256_sub_ps(_mm256_loadu_ps(input.z + slot), z);
      if constexpr (has_images) {
        dx = _mm256_sub_ps(dx, _mm256_set1_ps(static_cast<float>(shift.x)));
        dy = _mm256_sub_ps(dy, _mm256_set1_ps(static_cast<float>(shift.y)));
        dz = _mm256_sub_ps(dz, _mm256_set1_ps(static_cast<float>(shift.z)));
      }
      const __m256 squared =
          _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy)), _mm256_mul_ps(dz, dz));
      __m256 reach = size;
      if constexpr (has_radii) reach = _mm256_add_ps(reach, _mm256_loadu_ps(input.radii + slot));
      const __m256 limit = _mm256_mul_ps(reach, reach);
      __m256 doubt = _mm256_mul_ps(limit, relative_doubt);
      if constexpr (has_images) doubt = _mm256_add_ps(doubt, _mm256_mul_ps(reach, image_doubt));
      const unsigned live = live_lanes(run->end - slot, 8);
      const __m256 is_near = _mm256_cmp_ps(squared, _mm256_add_ps(limit, doubt), _CMP_LE_OQ);
      const __m256 is_far = _mm256_cmp_ps(squared, _mm256_sub_ps(limit, doubt), _CMP_GE_OQ);
      unsigned found = static_cast<unsigned>(_mm256_movemask_ps(is_near)) & live;
      const unsigned doubtful = static_cast<unsigned>(_mm256_movemask_ps(is_far)) & found;
      if (doubtful != 0) [[unlikely]] {
        found = without_misses(input, *run, slot, found, doubtful);
      }
      hits += store_hits(found, slot, q, hit_queries + hits, hit_slots + hits);
    }
  }
  return hits;
}

template <bool has_radii, bool has_images>
FC_AVX2 std::int64_t filter_avx2(const FilterInput<double>& input, const Run* runs, int run_count,
                                 std::uint32_t* hit_queries, std::uint32_t* hit_slots) {
  const __m256d margin = _mm256_set1_pd(input.reach.margin);
  const unsigned on_limit = input.reach.is_inclusive ? 0xFu : 0u;
  std::int64_t hits = 0;
  for (const Run* run = runs; run < runs + run_count; ++run) {
    const std::uint32_t q = run->query;
    const __m256d x = _mm256_set1_pd(input.query_x[q]), y = _mm256_set1_pd(input.query_y[q]),
                  z = _mm256_set1_pd(input.query_z[q]);
    const __m256d radius = _mm256_set1_pd(input.query_radii == nullptr ? 0.0 : input.query_radii[q]);
    Point<double> shift{};
    if constexpr (has_images) shift = input.reach.period.shift(run->image);
    for (std::uint32_t slot = run->begin; slot < run->end; slot += 4) {
      __m256d dx = _mm256_sub_pd(_mm256_loadu_pd(input.x + slot), x);
      __m256d dy = _mm256_sub_pd(_mm256_loadu_pd(input.y + slot), y);
      __m256d dz = _mm256_sub_pd(_mm256_loadu_pd(input.z + slot), z);
      if constexpr (has_images) {
        dx = _mm256_sub_pd(dx, _mm256_set1_pd(shift.x));
        dy = _mm256_sub_pd(dy, _mm256_set1_pd(shift.y));
        dz = _mm256_sub_pd(dz, _mm256_set1_pd(shift.z));
      }
      const __m256d squared =
          _mm256_add_pd(_mm256_add_pd(_mm256_mul_pd(dx, dx), _mm256_mul_pd(dy, dy)), _mm256_mul_pd(dz, dz));
      __m256d reach = radius;
      if constexpr (has_radii) reach = _mm256_add_pd(reach, _mm256_loadu_pd(input.radii + slot));
      reach = _mm256_add_pd(reach, margin);
      const __m256d limit = _mm256_mul_pd(reach, reach);
      const unsigned inside = static_cast<unsigned>(_mm256_movemask_pd(_mm256_cmp_pd(squared, limit, _CMP_LT_OQ)));
      const unsigned on = static_cast<unsigned>(_mm256_movemask_pd(_mm256_cmp_pd(squared, limit, _CMP_EQ_OQ)));
      const unsigned found = (inside | (on & on_limit)) & live_lanes(run->end - slot, 4);
      hits += store_hits(found, slot, q, hit_queries + hits, hit_slots + hits);
    }
  }
  return hits;
}

#define FC_CHOOSE(filter)                                                                                              \
  [](const FilterInput<T>& input, const Run* runs, int run_count, std::uint32_t* hit_queries,                          \
     std::uint32_t* hit_slots) {                                                                                       \
    const auto choose = [&](auto radii) {                                                                              \
      return input.reach.period.is_any() ? filter<radii.value, true>(input, runs, run_count, hit_queries, hit_slots)   \
                                         : filter<radii.value, false>(input, runs, run_count, hit_queries, hit_slots); \
    };                                                                                                                 \
    return input.radii != nullptr ? choose(std::true_type{}) : choose(std::false_type{});                              \
  }
#endif

}  // namespace

Simd best_simd() {
  Simd best = Simd::none;
#if FC_HAS_X86_SIMD
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2")) best = Simd::avx2;
  if (best == Simd::avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) {
    best = Simd::avx512;
  }
#endif
  const char* wish = std::getenv("FASTCOLLIDE_SIMD");
  if (wish == nullptr) return best;
  if (std::strcmp(wish, "none") == 0) return Simd::none;
  return std::strcmp(wish, "avx2") == 0 ? std::min(best, Simd::avx2) : best;
}

template <class T>
FilterRuns<T> filter_runs(Simd simd) {
#if FC_HAS_X86_SIMD
  if (simd == Simd::avx512) return FC_CHOOSE(filter_avx512);
  if (simd == Simd::avx2) return FC_CHOOSE(filter_avx2);
#endif
  static_cast<void>(simd);
  return filter_plainly<T>;
}

template FilterRuns<float> filter_runs<float>(Simd simd);
template FilterRuns<double> filter_runs<double>(Simd simd);

}  // namespace fastcollide::search
