// How many contacts push a sphere in the same direction: the factor by which the impulses that all its neighbours find
// at the same time have to be cut, so that together they do not overshoot.
//
// Each contact that carries load adds w n nᵀ to a tensor Q. The largest eigenvalue of Q is the largest number of
// (weighted) contacts along one direction: 0 in flight, 1 for one contact or two at a right angle, 2 between two
// plates.
#pragma once

#include "../math.hpp"

namespace fastcollide {

struct CrowdingSum {
  std::int64_t xx = 0, yy = 0, zz = 0, xy = 0, xz = 0, yz = 0;
};

FC_HOST_DEVICE inline void add(CrowdingSum& sum, const CrowdingSum& other) {
  sum.xx += other.xx;
  sum.yy += other.yy;
  sum.zz += other.zz;
  sum.xy += other.xy;
  sum.xz += other.xz;
  sum.yz += other.yz;
}

// A weight is at most (1 + sqrt 2) / 2, so a term fits in 32 bits; a sum of them gets 64.
inline constexpr float crowding_scale = 0x1p30f;

FC_HOST_DEVICE inline void add_contact(CrowdingSum& sum, Vec3 normal, float weight) {
  const Vec3 weighted = normal * (weight * crowding_scale);
  sum.xx += round_to_int32(weighted.x * normal.x);
  sum.yy += round_to_int32(weighted.y * normal.y);
  sum.zz += round_to_int32(weighted.z * normal.z);
  sum.xy += round_to_int32(weighted.x * normal.y);
  sum.xz += round_to_int32(weighted.x * normal.z);
  sum.yz += round_to_int32(weighted.y * normal.z);
}

// q + 2 p with q = tr Q / 3, p² = |Q - q I|² / 6: the closed form of the largest eigenvalue of a symmetric 3×3 matrix
// is q + 2 p cos φ (Smith, "Eigenvalues of a symmetric 3×3 matrix", CACM 4, 1961); without the cosine it is a bound.
FC_HOST_DEVICE inline float crowding_of(const CrowdingSum& sum) {
  const auto value = [](std::int64_t s) { return static_cast<float>(s) * (1.0f / crowding_scale); };
  const float xx = value(sum.xx), yy = value(sum.yy), zz = value(sum.zz);
  const float xy = value(sum.xy), xz = value(sum.xz), yz = value(sum.yz);
  const float mean = (xx + yy + zz) * (1.0f / 3.0f);
  const float a = xx - mean, b = yy - mean, c = zz - mean;
  const float square = (a * a + b * b + c * c + 2.0f * (xy * xy + xz * xz + yz * yz)) * (1.0f / 6.0f);
  return mean + 2.0f * square_root(square);
}

// What is kept from substep to substep is negative where no resting contact acts yet: of a sphere in flight, of one
// whose impacts wait. It is as crowded then as soon as those contacts are resting ones.
FC_HOST_DEVICE inline bool is_held(float crowding) { return crowding > 0.0f; }

// The sign alone tells it, also of -0: a contact may be too weak to count.
FC_HOST_DEVICE inline bool had_resting_contacts(float crowding) { return bits_of(crowding) >> 31 == 0; }

}  // namespace fastcollide
