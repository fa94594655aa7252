// Counter-based random numbers: the value for (seed, id, use) needs no state, so any thread may draw any of them.
#pragma once

#include "../math.hpp"

namespace fastcollide {

struct RandomWords {
  std::uint32_t word[4];
};

// Philox4x32-10: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC11, section 4.3.
FC_HOST_DEVICE inline RandomWords random_words(std::uint64_t seed, std::uint64_t id, std::uint64_t use) {
  std::uint32_t c0 = static_cast<std::uint32_t>(id), c1 = static_cast<std::uint32_t>(id >> 32);
  std::uint32_t c2 = static_cast<std::uint32_t>(use), c3 = static_cast<std::uint32_t>(use >> 32);
  std::uint32_t k0 = static_cast<std::uint32_t>(seed), k1 = static_cast<std::uint32_t>(seed >> 32);
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t p0 = std::uint64_t(0xD2511F53u) * c0;
    const std::uint64_t p1 = std::uint64_t(0xCD9E8D57u) * c2;
    c0 = static_cast<std::uint32_t>(p1 >> 32) ^ c1 ^ k0;
    c1 = static_cast<std::uint32_t>(p1);
    c2 = static_cast<std::uint32_t>(p0 >> 32) ^ c3 ^ k1;
    c3 = static_cast<std::uint32_t>(p0);
    k0 += 0x9E3779B9u;
    k1 += 0xBB67AE85u;
  }
  return {{c0, c1, c2, c3}};
}

// Uniform in [low, high]: 24 random bits, so that the fraction is exact.
FC_HOST_DEVICE inline float uniform(std::uint32_t word, float low, float high) {
  const float fraction = static_cast<float>(word >> 8) * 0x1p-24f;
  return clamp(low + (high - low) * fraction, low, high);
}

}  // namespace fastcollide
