// For AVX2 and AVX-512; the terms in a loop that compilers turn into vector instructions.
#include "contact_block.hpp"

#include "../backend/lane_table.hpp"
#include "../backend/x86_vectors.hpp"

// Terms are integers here: see FASTCOLLIDE_FREE_ORDER in math.hpp.
#if FC_HAS_X86_SIMD && !defined(FASTCOLLIDE_FREE_ORDER)

namespace fastcollide {
namespace {

#define FC_TARGET __attribute__((target("avx2,bmi,popcnt")))

// Inlined into functions for different instructions.
[[gnu::always_inline]] inline void find_all(const Substep& law, Vec3 period, bool is_rough, int count,
                                            ContactBlock& block) {
  const Substep substep = law;  // nothing that is written may change it
  const bool has_gravity = substep.law.gravity > 0.0f;
  for (int i = 0; i < count; ++i) {
    const Sphere self = falling_sphere(block.self.sphere(i), substep.flight);
    const Sphere neighbor = falling_sphere(block.neighbor.sphere(i), substep.flight);
    const bool near = are_near(self, neighbor.position, neighbor.radius, period, substep.law.opening_margin);
    const ContactTerms terms =
        contact_terms(substep, period, is_rough, self, block.self.crowding[i], neighbor, block.neighbor.crowding[i]);
    const Vec3 normal = terms.contact.normal;
    const bool is_counted = near & terms.is_counted, is_resting = near & terms.is_resting;
    const float change = is_resting ? terms.change : 0.0f;
    ExactSum3 exact;
    const bool is_in_range = add_exactly(exact, normal * change, substep.velocity_scale);
    CrowdingSum crowd;
    add_contact(crowd, normal, is_counted & has_gravity ? terms.weight : 0.0f);
    block.normal_x[i] = normal.x;
    block.normal_y[i] = normal.y;
    block.normal_z[i] = normal.z;
    block.depth[i] = terms.contact.depth;
    block.push[i] = terms.push;
    block.speed[i] = terms.speed;
    block.part[i] = terms.part;
    block.met_at[i] = terms.met_at;
    block.is_counted[i] = is_counted ? 1 : 0;
    block.is_resting[i] = is_resting ? 1 : 0;
    block.is_impact[i] = near & terms.is_impact ? 1 : 0;
    block.out_of_range[i] = is_in_range ? 0 : 1;
    block.change_x[i] = exact.x;
    block.change_y[i] = exact.y;
    block.change_z[i] = exact.z;
    block.xx[i] = static_cast<std::int32_t>(crowd.xx);
    block.yy[i] = static_cast<std::int32_t>(crowd.yy);
    block.zz[i] = static_cast<std::int32_t>(crowd.zz);
    block.xy[i] = static_cast<std::int32_t>(crowd.xy);
    block.xz[i] = static_cast<std::int32_t>(crowd.xz);
    block.yz[i] = static_cast<std::int32_t>(crowd.yz);
  }
}

FC_TARGET __attribute__((flatten)) void find_by_avx2(const Substep& substep, Vec3 period, bool is_rough, int count,
                                                     ContactBlock& block) {
  find_all(substep, period, is_rough, count, block);
}
__attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,prefer-vector-width=512"), flatten)) void find_by_avx512(
    const Substep& substep, Vec3 period, bool is_rough, int count, ContactBlock& block) {
  find_all(substep, period, is_rough, count, block);
}

struct Columns {
  __m256 x, y, z, w;
};

[[gnu::always_inline]] FC_TARGET inline __m256 two_of(const Vec4* rows, std::uint32_t low, std::uint32_t high) {
  return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(&rows[low].x)), _mm_load_ps(&rows[high].x), 1);
}
[[gnu::always_inline]] FC_TARGET inline Columns columns_of(const Vec4* rows, const std::uint32_t* slots) {
  const __m256 a = two_of(rows, slots[0], slots[4]), b = two_of(rows, slots[1], slots[5]);
  const __m256 c = two_of(rows, slots[2], slots[6]), d = two_of(rows, slots[3], slots[7]);
  const __m256 low_ab = _mm256_unpacklo_ps(a, b), high_ab = _mm256_unpackhi_ps(a, b);
  const __m256 low_cd = _mm256_unpacklo_ps(c, d), high_cd = _mm256_unpackhi_ps(c, d);
  return {_mm256_shuffle_ps(low_ab, low_cd, 0x44), _mm256_shuffle_ps(low_ab, low_cd, 0xEE),
          _mm256_shuffle_ps(high_ab, high_cd, 0x44), _mm256_shuffle_ps(high_ab, high_cd, 0xEE)};
}

[[gnu::always_inline]] FC_TARGET inline __m256 to_nearest_image(__m256 difference, float period) {
  if (!(period > 0.0f)) return difference;
  const __m256 length = _mm256_set1_ps(period), half = _mm256_set1_ps(0.5f * period);
  const __m256 above = _mm256_cmp_ps(difference, half, _CMP_GT_OQ);
  const __m256 below = _mm256_cmp_ps(difference, _mm256_sub_ps(_mm256_setzero_ps(), half), _CMP_LT_OQ);
  return _mm256_add_ps(_mm256_sub_ps(difference, _mm256_and_ps(above, length)), _mm256_and_ps(below, length));
}

[[gnu::always_inline]] FC_TARGET inline void fill(float* to, float value) {
  _mm256_storeu_ps(to, _mm256_set1_ps(value));
}

FC_TARGET int collect(const GridView& grid, float margin, std::int64_t slot, const std::uint32_t* list, int listed,
                      int place, ContactBlock& block) {
  ContactBlock::Side &self = block.self, &neighbor = block.neighbor;
  const Vec4 here = grid.position_radius[slot];
  const __m256 x = _mm256_set1_ps(here.x), y = _mm256_set1_ps(here.y), z = _mm256_set1_ps(here.z);
  const __m256 reach = _mm256_set1_ps(here.w + margin);
  int end = place;
  for (int k = 0; k < listed; k += 8) {
    const __m256i lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const __m256i is_listed = _mm256_cmpgt_epi32(_mm256_set1_epi32(listed - k), lanes);
    // What lies behind the list is no slot.
    const __m256i others =
        _mm256_blendv_epi8(_mm256_set1_epi32(static_cast<int>(slot)),
                           _mm256_loadu_si256(reinterpret_cast<const __m256i*>(list + k)), is_listed);
    alignas(32) std::uint32_t slots[8];
    _mm256_store_si256(reinterpret_cast<__m256i*>(slots), others);
    const Columns there = columns_of(grid.position_radius, slots);
    const __m256 dx = to_nearest_image(_mm256_sub_ps(x, there.x), grid.period.x);
    const __m256 dy = to_nearest_image(_mm256_sub_ps(y, there.y), grid.period.y);
    const __m256 dz = to_nearest_image(_mm256_sub_ps(z, there.z), grid.period.z);
    const __m256 squared =
        _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy)), _mm256_mul_ps(dz, dz));
    // A little farther than are_near(), which decides later.
    const __m256 most = _mm256_mul_ps(_mm256_add_ps(reach, there.w), _mm256_set1_ps(1.00001f));
    const __m256 near =
        _mm256_and_ps(_mm256_cmp_ps(squared, _mm256_mul_ps(most, most), _CMP_LE_OQ), _mm256_castsi256_ps(is_listed));
    const auto found = static_cast<unsigned>(_mm256_movemask_ps(near));
    const __m256i order = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<long long>(lane_table.lanes[found])));
    _mm256_storeu_ps(neighbor.x + end, _mm256_permutevar8x32_ps(there.x, order));
    _mm256_storeu_ps(neighbor.y + end, _mm256_permutevar8x32_ps(there.y, order));
    _mm256_storeu_ps(neighbor.z + end, _mm256_permutevar8x32_ps(there.z, order));
    _mm256_storeu_ps(neighbor.radius + end, _mm256_permutevar8x32_ps(there.w, order));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(block.others + end), _mm256_permutevar8x32_epi32(others, order));
    end += _mm_popcnt_u32(found);
  }
  for (int k = place; k < end; k += 8) {
    // Those behind the last one are any that were there before: slots, too.
    const __m256i others = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(block.others + k));
    const Columns velocity = columns_of(grid.velocity_restitution, block.others + k);
    _mm256_storeu_ps(neighbor.velocity_x + k, velocity.x);
    _mm256_storeu_ps(neighbor.velocity_y + k, velocity.y);
    _mm256_storeu_ps(neighbor.velocity_z + k, velocity.z);
    _mm256_storeu_ps(neighbor.mass + k, _mm256_i32gather_ps(&grid.mass_ids->mass, others, sizeof(MassId)));
    _mm256_storeu_ps(neighbor.crowding + k, _mm256_i32gather_ps(grid.crowding, others, 4));
    _mm256_storeu_si256(
        reinterpret_cast<__m256i*>(neighbor.ids + k),
        _mm256_i32gather_epi32(reinterpret_cast<const int*>(&grid.mass_ids->id), others, sizeof(MassId)));
    const Vec4 own_velocity = grid.velocity_restitution[slot];
    fill(self.x + k, here.x);
    fill(self.y + k, here.y);
    fill(self.z + k, here.z);
    fill(self.radius + k, here.w);
    fill(self.velocity_x + k, own_velocity.x);
    fill(self.velocity_y + k, own_velocity.y);
    fill(self.velocity_z + k, own_velocity.z);
    fill(self.mass + k, grid.mass_ids[slot].mass);
    fill(self.crowding + k, grid.crowding[slot]);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(self.ids + k),
                        _mm256_set1_epi32(static_cast<int>(grid.mass_ids[slot].id)));
  }
  return end;
}

}  // namespace

std::optional<BlockFunctions> block_functions(search::Simd simd) {
  switch (simd) {
    case search::Simd::avx512:
      return BlockFunctions{collect, find_by_avx512};
    case search::Simd::avx2:
      return BlockFunctions{collect, find_by_avx2};
    default:
      return {};
  }
}

}  // namespace fastcollide
#else
namespace fastcollide {

std::optional<BlockFunctions> block_functions(search::Simd) { return {}; }

}  // namespace fastcollide
#endif
