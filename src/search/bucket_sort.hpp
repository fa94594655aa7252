// Counting sort in two passes on CPU threads: into buckets of keys that lie side by side, then within each bucket,
// where all that is touched fits into the cache. Stable, and the same result at any number of threads.
#pragma once

#include <bit>
#include <cstring>

#include "../backend/cpu.hpp"
#include "slabs.hpp"

namespace fastcollide::search {

// 64-bit words whose upper half is the key.
constexpr std::uint64_t word_of(std::uint32_t key, std::uint32_t value) { return std::uint64_t(key) << 32 | value; }
constexpr std::uint32_t key_of(std::uint64_t word) { return static_cast<std::uint32_t>(word >> 32); }

// Keys are 0 ... key_count - 1; a bucket has 2^shift of them, so many that what is done in it stays in the cache.
struct Buckets {
  int shift, count;

  explicit Buckets(std::int64_t key_count) {
    constexpr int keys_in_bucket_bits = 8, most_bits = 11;
    // Some buckets even where there are few keys: what belongs to each may be much.
    const int key_bits = std::max(1, static_cast<int>(std::bit_width(static_cast<std::uint64_t>(key_count - 1))));
    const int bits = std::clamp(key_bits - keys_in_bucket_bits, std::min(key_bits, 5), most_bits);
    shift = key_bits - bits;
    count = static_cast<int>((key_count - 1) >> shift) + 1;
  }
};

class BucketSort {
 public:
  explicit BucketSort(CpuBackend& backend) : words_(backend) {}

  // Adds to `counts` the words of each bucket.
  static void count(const Buckets& buckets, const std::uint64_t* begin, const std::uint64_t* end, std::int64_t* counts) {
    for (const std::uint64_t* word = begin; word != end; ++word) ++counts[key_of(*word) >> buckets.shift];
  }

  // count_part(slab, counts) adds the words of a slab to those of each bucket, and may write them before; part(slab)
  // gives them, as a pair of pointers; finish(first_key, end_key, first_place, begin, end) gets the words of each bucket,
  // in the order of the slabs, with the place of the first among all.
  template <class CountPart, class Part, class Finish>
  void sort(const Slabs& slabs, const Buckets& buckets, std::int64_t key_count, int parts, std::int64_t words,
            const CountPart& count_part, const Part& part, const Finish& finish) {
    const auto bucket_count = static_cast<std::size_t>(buckets.count);
    places_.assign(static_cast<std::size_t>(parts) * bucket_count, 0);
    words_.resize(words);
    slabs.run(parts, parts, [&](int slab, std::int64_t, std::int64_t) {
      count_part(slab, places_.data() + static_cast<std::size_t>(slab) * bucket_count);
    });
    starts_.resize(bucket_count + 1);
    std::int64_t place = 0;
    for (std::size_t bucket = 0; bucket < bucket_count; ++bucket) {
      starts_[bucket] = place;
      for (int slab = 0; slab < parts; ++slab) {
        std::int64_t& here = places_[static_cast<std::size_t>(slab) * bucket_count + bucket];
        const std::int64_t count = here;
        here = place;
        place += count;
      }
    }
    starts_[bucket_count] = place;
    slabs.run(parts, parts, [&](int slab, std::int64_t, std::int64_t) {
      std::int64_t* next = places_.data() + static_cast<std::size_t>(slab) * bucket_count;
      std::uint64_t* to = words_.data();
      const auto [begin, end] = part(slab);
      for (const std::uint64_t* word = begin; word != end; ++word) to[next[key_of(*word) >> buckets.shift]++] = *word;
    });
    slabs.run(slabs.count(buckets.count, 4, 4), buckets.count, [&](int, std::int64_t begin, std::int64_t end) {
      for (std::int64_t bucket = begin; bucket < end; ++bucket) {
        const std::int64_t first = starts_[static_cast<std::size_t>(bucket)],
                           last = starts_[static_cast<std::size_t>(bucket) + 1];
        finish(bucket << buckets.shift, std::min((bucket + 1) << buckets.shift, key_count), first,
               words_.data() + first, words_.data() + last);
      }
    });
  }

 private:
  std::vector<std::int64_t> places_, starts_;
  CpuBackend::Buffer<std::uint64_t> words_;
};

}  // namespace fastcollide::search
