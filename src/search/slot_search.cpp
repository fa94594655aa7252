#include "slot_search.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdlib>
#include <cstring>

#include "../backend/lane_table.hpp"
#include "../backend/x86_vectors.hpp"

namespace fastcollide::search {
namespace {

// In single precision d² and (r₁ + r₂ + margin)² are off by less than 12 units of 2^-24 together, relative; across a
// periodic end each difference by up to 2 periods · 2^-24 more, and d² by 2 d times that along each axis.
constexpr float doubt_of_rounding = 0x1p-19f;

float doubt_of_images(const Period& period) { return static_cast<float>((period.x + period.y + period.z) * 0x1p-21); }

template <class T>
bool is_hit(const Compared<T>& input, std::uint32_t q, int image, std::uint32_t slot) {
  const Slots<T>&a = input.searchers, &b = input.targets;
  return is_within_reach<T>(a.position(q), a.radius(q), b.position(slot), b.radius(slot),
                            input.reach.period.shift(image), input.reach);
}

// Without the hits among `doubtful` lanes that double precision refuses.
template <class T>
unsigned without_misses(const Compared<T>& input, std::uint32_t q, int image, std::uint32_t slot, unsigned hits,
                        unsigned doubtful) {
  for (; doubtful != 0; doubtful &= doubtful - 1) {
    const int lane = std::countr_zero(doubtful);
    if (!is_hit(input, q, image, slot + static_cast<std::uint32_t>(lane))) hits &= ~(1u << lane);
  }
  return hits;
}

// Hits are collected until there are enough to be worth a call.
struct HitBuffer {
  static constexpr std::int64_t room = 8192, worth_a_call = 512;  // a call's hits stay in the cache

  explicit HitBuffer(HitSink to) : sink(to) {}

  void make_room(std::int64_t more) {
    if (count + more > room) [[unlikely]]
      flush();
  }
  void flush() {
    if (count > 0) sink.take(sink.context, count, pairs, pairs + way);
    count = 0;
  }

  HitSink sink;
  std::int64_t count = 0;
  // The ids of those that searched, and a fixed way behind them of those that were found.
  static constexpr std::int64_t way = room + slot_padding;
  std::uint32_t pairs[2 * way];
};

namespace plain {
#define FC_TARGET

template <class T>
struct Lanes {
  static constexpr std::uint32_t width = 8;

  struct Query {
    std::uint32_t index, id;
    int image;
  };

  template <bool has_radii>
  static Query query(const Compared<T>& input, std::uint32_t q) {
    return {q, input.searchers.ids[q], no_image};
  }
  static void set_image(const Compared<T>&, Query& query, int image) { query.image = image; }

  template <bool has_radii, bool has_images>
  static unsigned compare(const Compared<T>& input, const Query& query, std::uint32_t slot, unsigned live) {
    return without_misses(input, query.index, query.image, slot, live, live);
  }

  static int store(const Compared<T>& input, const Query& query, std::uint32_t slot, unsigned found,
                   std::uint32_t* pairs) {
    int hits = 0;
    for (; found != 0; found &= found - 1) {
      pairs[hits] = query.id;
      pairs[HitBuffer::way + hits++] = input.targets.ids[slot + static_cast<std::uint32_t>(std::countr_zero(found))];
    }
    return hits;
  }
};

#include "slot_kernel.hpp"

#undef FC_TARGET
}  // namespace plain

#if FC_HAS_X86_SIMD
namespace avx2 {
#define FC_TARGET __attribute__((target("avx2,bmi,bmi2,popcnt")))

FC_TARGET inline __m256i lanes_of(unsigned found) {
  return _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<long long>(lane_table.lanes[found])));
}

template <class T>
struct Lanes;

template <>
struct Lanes<float> {
  static constexpr std::uint32_t width = 8;

  struct Query {
    std::uint32_t index;
    int image;
    __m256 x, y, z, size;  // size: radius + margin
    __m256 shift_x, shift_y, shift_z, image_doubt;
    __m256i id;
  };

  template <bool has_radii>
  [[gnu::always_inline]] FC_TARGET static Query query(const Compared<float>& input, std::uint32_t q) {
    const Slots<float>& from = input.searchers;
    Query query;
    query.index = q;
    query.image = no_image;
    const float* place = from.x + q;
    query.x = _mm256_set1_ps(*place);
    query.y = _mm256_set1_ps(place[from.stride]);
    query.z = _mm256_set1_ps(place[2 * from.stride]);
    query.size = _mm256_set1_ps(static_cast<float>(input.reach.margin));
    if constexpr (has_radii) {
      query.size = _mm256_add_ps(query.size, _mm256_set1_ps(place[3 * from.stride]));
    }
    query.id = _mm256_set1_epi32(static_cast<int>(from.ids[q]));
    return query;
  }

  FC_TARGET static void set_image(const Compared<float>& input, Query& query, int image) {
    const Point<double> shift = input.reach.period.shift(image);
    query.image = image;
    query.shift_x = _mm256_set1_ps(static_cast<float>(shift.x));
    query.shift_y = _mm256_set1_ps(static_cast<float>(shift.y));
    query.shift_z = _mm256_set1_ps(static_cast<float>(shift.z));
    query.image_doubt = _mm256_set1_ps(doubt_of_images(input.reach.period));
  }

  template <bool has_radii, bool has_images>
  [[gnu::always_inline]] FC_TARGET static unsigned compare(const Compared<float>& input, const Query& query,
                                                           std::uint32_t slot, unsigned live) {
    const std::int64_t stride = input.targets.stride;
    const float* place = input.targets.x + slot;
    __m256 dx = _mm256_sub_ps(query.x, _mm256_loadu_ps(place));
    __m256 dy = _mm256_sub_ps(query.y, _mm256_loadu_ps(place + stride));
    __m256 dz = _mm256_sub_ps(query.z, _mm256_loadu_ps(place + 2 * stride));
    if constexpr (has_images) {
      dx = _mm256_add_ps(dx, query.shift_x);
      dy = _mm256_add_ps(dy, query.shift_y);
      dz = _mm256_add_ps(dz, query.shift_z);
    }
    const __m256 squared =
        _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy)), _mm256_mul_ps(dz, dz));
    __m256 reach = query.size;
    if constexpr (has_radii) reach = _mm256_add_ps(reach, _mm256_loadu_ps(place + 3 * stride));
    const __m256 limit = _mm256_mul_ps(reach, reach);
    __m256 doubt = _mm256_mul_ps(limit, _mm256_set1_ps(doubt_of_rounding));
    if constexpr (has_images) doubt = _mm256_add_ps(doubt, _mm256_mul_ps(reach, query.image_doubt));
    const __m256 near_limit = _mm256_add_ps(limit, doubt), far_limit = _mm256_sub_ps(limit, doubt);
    const __m256 is_near = _mm256_cmp_ps(squared, near_limit, _CMP_LE_OQ);
    const __m256 is_far = _mm256_cmp_ps(squared, far_limit, _CMP_GE_OQ);
    unsigned found = static_cast<unsigned>(_mm256_movemask_ps(is_near)) & live;
    if (_mm256_testz_ps(is_near, is_far) == 0) [[unlikely]] {
      const unsigned doubtful = static_cast<unsigned>(_mm256_movemask_ps(is_far)) & found;
      found = without_misses(input, query.index, query.image, slot, found, doubtful);
    }
    return found;
  }

  // Up to 8 places are written.
  [[gnu::always_inline]] FC_TARGET static int store(const Compared<float>& input, const Query& query,
                                                    std::uint32_t slot, unsigned found, std::uint32_t* pairs) {
    const __m256i all = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(input.targets.ids + slot));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(pairs), query.id);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(pairs + HitBuffer::way),
                        _mm256_permutevar8x32_epi32(all, lanes_of(found)));
    return _mm_popcnt_u32(found);
  }
};

template <>
struct Lanes<double> {
  static constexpr std::uint32_t width = 4;

  struct Query {
    std::uint32_t index;
    int image;
    __m256d x, y, z, radius, margin;
    __m256d shift_x, shift_y, shift_z;
    unsigned on_limit;  // the lanes that count where a distance is the limit
    __m128i id;
  };

  template <bool has_radii>
  [[gnu::always_inline]] FC_TARGET static Query query(const Compared<double>& input, std::uint32_t q) {
    const Slots<double>& from = input.searchers;
    Query query;
    query.index = q;
    query.image = no_image;
    const double* place = from.x + q;
    query.x = _mm256_set1_pd(*place);
    query.y = _mm256_set1_pd(place[from.stride]);
    query.z = _mm256_set1_pd(place[2 * from.stride]);
    query.radius = _mm256_set1_pd(has_radii ? place[3 * from.stride] : 0.0);
    query.margin = _mm256_set1_pd(input.reach.margin);
    query.on_limit = input.reach.is_inclusive ? 0xfu : 0u;
    query.id = _mm_set1_epi32(static_cast<int>(from.ids[q]));
    return query;
  }

  FC_TARGET static void set_image(const Compared<double>& input, Query& query, int image) {
    const Point<double> shift = input.reach.period.shift(image);
    query.image = image;
    query.shift_x = _mm256_set1_pd(shift.x);
    query.shift_y = _mm256_set1_pd(shift.y);
    query.shift_z = _mm256_set1_pd(shift.z);
  }

  template <bool has_radii, bool has_images>
  [[gnu::always_inline]] FC_TARGET static unsigned compare(const Compared<double>& input, const Query& query,
                                                           std::uint32_t slot, unsigned live) {
    const std::int64_t stride = input.targets.stride;
    const double* place = input.targets.x + slot;
    __m256d dx = _mm256_sub_pd(query.x, _mm256_loadu_pd(place));
    __m256d dy = _mm256_sub_pd(query.y, _mm256_loadu_pd(place + stride));
    __m256d dz = _mm256_sub_pd(query.z, _mm256_loadu_pd(place + 2 * stride));
    if constexpr (has_images) {
      dx = _mm256_add_pd(dx, query.shift_x);
      dy = _mm256_add_pd(dy, query.shift_y);
      dz = _mm256_add_pd(dz, query.shift_z);
    }
    const __m256d squared =
        _mm256_add_pd(_mm256_add_pd(_mm256_mul_pd(dx, dx), _mm256_mul_pd(dy, dy)), _mm256_mul_pd(dz, dz));
    __m256d reach = query.radius;
    if constexpr (has_radii) reach = _mm256_add_pd(reach, _mm256_loadu_pd(place + 3 * stride));
    reach = _mm256_add_pd(reach, query.margin);
    const __m256d limit = _mm256_mul_pd(reach, reach);
    const unsigned inside = static_cast<unsigned>(_mm256_movemask_pd(_mm256_cmp_pd(squared, limit, _CMP_LT_OQ)));
    const unsigned on = static_cast<unsigned>(_mm256_movemask_pd(_mm256_cmp_pd(squared, limit, _CMP_EQ_OQ)));
    return (inside | (on & query.on_limit)) & live;
  }

  // Up to 4 places are written.
  [[gnu::always_inline]] FC_TARGET static int store(const Compared<double>& input, const Query& query,
                                                    std::uint32_t slot, unsigned found, std::uint32_t* pairs) {
    const __m256i all =
        _mm256_castsi128_si256(_mm_loadu_si128(reinterpret_cast<const __m128i*>(input.targets.ids + slot)));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(pairs), query.id);
    _mm_storeu_si128(reinterpret_cast<__m128i*>(pairs + HitBuffer::way),
                     _mm256_castsi256_si128(_mm256_permutevar8x32_epi32(all, lanes_of(found))));
    return _mm_popcnt_u32(found);
  }
};

#include "slot_kernel.hpp"

#undef FC_TARGET
}  // namespace avx2

namespace avx512 {
#define FC_TARGET __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,bmi,bmi2,popcnt")))

template <class T>
struct Lanes;

template <>
struct Lanes<float> {
  static constexpr std::uint32_t width = 16;

  struct Query {
    std::uint32_t index;
    int image;
    __m512 x, y, z, size;  // size: radius + margin
    __m512 shift_x, shift_y, shift_z, image_doubt;
    __m512i id;
  };

  template <bool has_radii>
  [[gnu::always_inline]] FC_TARGET static Query query(const Compared<float>& input, std::uint32_t q) {
    const Slots<float>& from = input.searchers;
    Query query;
    query.index = q;
    query.image = no_image;
    const float* place = from.x + q;
    query.x = _mm512_set1_ps(*place);
    query.y = _mm512_set1_ps(place[from.stride]);
    query.z = _mm512_set1_ps(place[2 * from.stride]);
    query.size = _mm512_set1_ps(static_cast<float>(input.reach.margin));
    if constexpr (has_radii) {
      query.size = _mm512_add_ps(query.size, _mm512_set1_ps(place[3 * from.stride]));
    }
    query.id = _mm512_set1_epi32(static_cast<int>(from.ids[q]));
    return query;
  }

  FC_TARGET static void set_image(const Compared<float>& input, Query& query, int image) {
    const Point<double> shift = input.reach.period.shift(image);
    query.image = image;
    query.shift_x = _mm512_set1_ps(static_cast<float>(shift.x));
    query.shift_y = _mm512_set1_ps(static_cast<float>(shift.y));
    query.shift_z = _mm512_set1_ps(static_cast<float>(shift.z));
    query.image_doubt = _mm512_set1_ps(doubt_of_images(input.reach.period));
  }

  template <bool has_radii, bool has_images>
  [[gnu::always_inline]] FC_TARGET static unsigned compare(const Compared<float>& input, const Query& query,
                                                           std::uint32_t slot, unsigned live) {
    const std::int64_t stride = input.targets.stride;
    const float* place = input.targets.x + slot;
    __m512 dx = _mm512_sub_ps(query.x, _mm512_loadu_ps(place));
    __m512 dy = _mm512_sub_ps(query.y, _mm512_loadu_ps(place + stride));
    __m512 dz = _mm512_sub_ps(query.z, _mm512_loadu_ps(place + 2 * stride));
    if constexpr (has_images) {
      dx = _mm512_add_ps(dx, query.shift_x);
      dy = _mm512_add_ps(dy, query.shift_y);
      dz = _mm512_add_ps(dz, query.shift_z);
    }
    const __m512 squared =
        _mm512_add_ps(_mm512_add_ps(_mm512_mul_ps(dx, dx), _mm512_mul_ps(dy, dy)), _mm512_mul_ps(dz, dz));
    __m512 reach = query.size;
    if constexpr (has_radii) reach = _mm512_add_ps(reach, _mm512_loadu_ps(place + 3 * stride));
    const __m512 limit = _mm512_mul_ps(reach, reach);
    __m512 doubt = _mm512_mul_ps(limit, _mm512_set1_ps(doubt_of_rounding));
    if constexpr (has_images) doubt = _mm512_add_ps(doubt, _mm512_mul_ps(reach, query.image_doubt));
    const __m512 near_limit = _mm512_add_ps(limit, doubt), far_limit = _mm512_sub_ps(limit, doubt);
    unsigned found = _mm512_mask_cmp_ps_mask(static_cast<__mmask16>(live), squared, near_limit, _CMP_LE_OQ);
    const unsigned doubtful = _mm512_mask_cmp_ps_mask(static_cast<__mmask16>(found), squared, far_limit, _CMP_GE_OQ);
    if (doubtful != 0) [[unlikely]] {
      found = without_misses(input, query.index, query.image, slot, found, doubtful);
    }
    return found;
  }

  // Up to 16 places are written.
  [[gnu::always_inline]] FC_TARGET static int store(const Compared<float>& input, const Query& query,
                                                    std::uint32_t slot, unsigned found, std::uint32_t* pairs) {
    const __m512i all = _mm512_loadu_si512(input.targets.ids + slot);
    _mm512_storeu_si512(pairs, query.id);
    _mm512_storeu_si512(pairs + HitBuffer::way, _mm512_maskz_compress_epi32(static_cast<__mmask16>(found), all));
    return _mm_popcnt_u32(found);
  }
};

template <>
struct Lanes<double> {
  static constexpr std::uint32_t width = 8;

  struct Query {
    std::uint32_t index;
    int image;
    __m512d x, y, z, radius, margin;
    __m512d shift_x, shift_y, shift_z;
    unsigned on_limit;  // the lanes that count where a distance is the limit
    __m256i id;
  };

  template <bool has_radii>
  [[gnu::always_inline]] FC_TARGET static Query query(const Compared<double>& input, std::uint32_t q) {
    const Slots<double>& from = input.searchers;
    Query query;
    query.index = q;
    query.image = no_image;
    const double* place = from.x + q;
    query.x = _mm512_set1_pd(*place);
    query.y = _mm512_set1_pd(place[from.stride]);
    query.z = _mm512_set1_pd(place[2 * from.stride]);
    query.radius = _mm512_set1_pd(has_radii ? place[3 * from.stride] : 0.0);
    query.margin = _mm512_set1_pd(input.reach.margin);
    query.on_limit = input.reach.is_inclusive ? 0xffu : 0u;
    query.id = _mm256_set1_epi32(static_cast<int>(from.ids[q]));
    return query;
  }

  FC_TARGET static void set_image(const Compared<double>& input, Query& query, int image) {
    const Point<double> shift = input.reach.period.shift(image);
    query.image = image;
    query.shift_x = _mm512_set1_pd(shift.x);
    query.shift_y = _mm512_set1_pd(shift.y);
    query.shift_z = _mm512_set1_pd(shift.z);
  }

  template <bool has_radii, bool has_images>
  [[gnu::always_inline]] FC_TARGET static unsigned compare(const Compared<double>& input, const Query& query,
                                                           std::uint32_t slot, unsigned live) {
    const std::int64_t stride = input.targets.stride;
    const double* place = input.targets.x + slot;
    __m512d dx = _mm512_sub_pd(query.x, _mm512_loadu_pd(place));
    __m512d dy = _mm512_sub_pd(query.y, _mm512_loadu_pd(place + stride));
    __m512d dz = _mm512_sub_pd(query.z, _mm512_loadu_pd(place + 2 * stride));
    if constexpr (has_images) {
      dx = _mm512_add_pd(dx, query.shift_x);
      dy = _mm512_add_pd(dy, query.shift_y);
      dz = _mm512_add_pd(dz, query.shift_z);
    }
    const __m512d squared =
        _mm512_add_pd(_mm512_add_pd(_mm512_mul_pd(dx, dx), _mm512_mul_pd(dy, dy)), _mm512_mul_pd(dz, dz));
    __m512d reach = query.radius;
    if constexpr (has_radii) reach = _mm512_add_pd(reach, _mm512_loadu_pd(place + 3 * stride));
    reach = _mm512_add_pd(reach, query.margin);
    const __m512d limit = _mm512_mul_pd(reach, reach);
    const auto lanes = static_cast<__mmask8>(live);
    return static_cast<unsigned>(_mm512_mask_cmp_pd_mask(lanes, squared, limit, _CMP_LT_OQ)) |
           (static_cast<unsigned>(_mm512_mask_cmp_pd_mask(lanes, squared, limit, _CMP_EQ_OQ)) & query.on_limit);
  }

  // Up to 8 places are written.
  [[gnu::always_inline]] FC_TARGET static int store(const Compared<double>& input, const Query& query,
                                                    std::uint32_t slot, unsigned found, std::uint32_t* pairs) {
    const __m256i all = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(input.targets.ids + slot));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(pairs), query.id);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(pairs + HitBuffer::way),
                        _mm256_maskz_compress_epi32(static_cast<__mmask8>(found), all));
    return _mm_popcnt_u32(found);
  }
};

#include "slot_kernel.hpp"

#undef FC_TARGET
}  // namespace avx512
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
SearchSlots<T> search_slots(Simd simd) {
#if FC_HAS_X86_SIMD
  if (simd == Simd::avx512) return avx512::search<T>;
  if (simd == Simd::avx2) return avx2::search<T>;
#endif
  static_cast<void>(simd);
  return plain::search<T>;
}

template SearchSlots<float> search_slots<float>(Simd simd);
template SearchSlots<double> search_slots<double>(Simd simd);

}  // namespace fastcollide::search
