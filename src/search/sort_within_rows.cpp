#include "sort_within_rows.hpp"

#include <algorithm>

#include "../backend/x86_vectors.hpp"

namespace fastcollide::search {
namespace {

template <class Word>
void sort_nearly_sorted(Word* words, std::int64_t count) {
  for (std::int64_t place = 1; place < count; ++place) {
    const Word held = words[place];
    std::int64_t hole = place;
    for (; hole > 0 && words[hole - 1] > held; --hole) words[hole] = words[hole - 1];
    words[hole] = held;
  }
}

template <class Word>
void sort_words(Word* words, std::int64_t count, std::int64_t longest) {
  constexpr std::int64_t many = 32;
  if (longest > many) {
    std::sort(words, words + count);
  } else if (longest > 1) {
    sort_nearly_sorted(words, count);
  }
}

#if FC_HAS_X86_SIMD
// Rounds in which each word is compared with the next one or, every other round, with the one before: as many rounds as
// a row has words sort it (odd-even transposition sort), and no branch depends on the words.
__attribute__((target("avx2"))) void exchange_neighbors(std::uint32_t* words, std::int64_t count, std::int64_t rounds) {
  constexpr int lanes = 8;
  static_assert(lanes <= sort_padding);
  for (int lane = 0; lane < lanes; ++lane) words[count + lane] = ~std::uint32_t(0);  // stays where it is
  for (std::int64_t round = 0; round < rounds; ++round) {
    for (std::int64_t k = round % 2; k < count; k += lanes) {
      auto* here = reinterpret_cast<__m256i*>(words + k);
      const __m256i some = _mm256_loadu_si256(here);
      const __m256i others = _mm256_shuffle_epi32(some, 0b10110001);
      const __m256i lower = _mm256_min_epu32(some, others), higher = _mm256_max_epu32(some, others);
      _mm256_storeu_si256(here, _mm256_blend_epi32(lower, higher, 0b10101010));
    }
  }
}
#endif

}  // namespace

void sort_within_rows(std::uint32_t* words, std::int64_t count, std::int64_t longest, Simd simd) {
#if FC_HAS_X86_SIMD
  constexpr std::int64_t worth_it = 16;
  if (simd != Simd::none && longest <= worth_it) {
    if (longest > 1) exchange_neighbors(words, count, longest);
    return;
  }
#endif
  static_cast<void>(simd);
  sort_words(words, count, longest);
}

void sort_within_rows(std::uint64_t* words, std::int64_t count, std::int64_t longest, Simd) {
  sort_words(words, count, longest);
}

}  // namespace fastcollide::search
