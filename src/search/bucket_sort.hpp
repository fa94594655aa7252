// Counting sort in two passes on CPU threads: into buckets of keys that lie side by side, then within each bucket,
// where all that is touched fits into the cache. Stable, and the same result at any number of threads.
#pragma once

#include <bit>
#include <cstddef>

#include "../backend/cpu.hpp"
#include "slabs.hpp"

namespace fastcollide::search {

// Keys are 0 ... key_count - 1; a bucket has 2^shift of them, so many that what is done in it stays in the cache.
struct Buckets {
  int shift, count;

  explicit Buckets(std::int64_t key_count) {
    const int key_bits = std::max(1, static_cast<int>(std::bit_width(static_cast<std::uint64_t>(key_count - 1))));
    // 256 keys in each of up to 512 buckets, then up to 2,048 keys in each of up to 2,048: to write to many places in
    // turn takes longer than to sort what no longer fits into the first cache. Some buckets even of few keys: what
    // belongs to each may be much.
    const int few_bits = std::clamp(key_bits - 8, std::min(key_bits, 5), 9);
    const int bits = std::clamp(key_bits - 11, few_bits, 11);
    shift = key_bits - bits;
    count = static_cast<int>((key_count - 1) >> shift) + 1;
  }
};

class BucketSort {
 public:
  explicit BucketSort(CpuBackend& backend) : memory_(backend) {}

  // count_part(slab, counts) adds the entries of a slab to those of each bucket; move_part(slab, next, entries) writes
  // each entry to the next place of its bucket, which moves on; finish(first_key, end_key, first_place, begin, end)
  // gets the entries of each bucket, in the order of the slabs, with the place of the first among all.
  template <class Entry, class CountPart, class MovePart, class Finish>
  void sort(const Slabs& slabs, const Buckets& buckets, std::int64_t key_count, int parts, std::int64_t count,
            const CountPart& count_part, const MovePart& move_part, const Finish& finish) {
    const auto bucket_count = static_cast<std::size_t>(buckets.count);
    places_.assign(static_cast<std::size_t>(parts) * bucket_count, 0);
    static_assert(std::is_trivially_copyable_v<Entry> && alignof(Entry) <= alignof(std::max_align_t));
    memory_.resize(count * static_cast<std::int64_t>(sizeof(Entry)));
    auto* entries = reinterpret_cast<Entry*>(memory_.data());
    slabs.run(parts, parts, [&](int slab, std::int64_t, std::int64_t) {
      count_part(slab, places_.data() + static_cast<std::size_t>(slab) * bucket_count);
    });
    starts_.resize(bucket_count + 1);
    std::int64_t place = 0;
    for (std::size_t bucket = 0; bucket < bucket_count; ++bucket) {
      starts_[bucket] = place;
      for (int slab = 0; slab < parts; ++slab) {
        std::int64_t& here = places_[static_cast<std::size_t>(slab) * bucket_count + bucket];
        const std::int64_t entries = here;
        here = place;
        place += entries;
      }
    }
    starts_[bucket_count] = place;
    slabs.run(parts, parts, [&](int slab, std::int64_t, std::int64_t) {
      move_part(slab, places_.data() + static_cast<std::size_t>(slab) * bucket_count, entries);
    });
    slabs.run(slabs.count(buckets.count, 4, 4), buckets.count, [&](int, std::int64_t begin, std::int64_t end) {
      for (std::int64_t bucket = begin; bucket < end; ++bucket) {
        const std::int64_t first = starts_[static_cast<std::size_t>(bucket)],
                           last = starts_[static_cast<std::size_t>(bucket) + 1];
        finish(bucket << buckets.shift, std::min((bucket + 1) << buckets.shift, key_count), first, entries + first,
               entries + last);
      }
    });
  }

 private:
  std::vector<std::int64_t> places_, starts_;
  CpuBackend::Buffer<std::byte> memory_;  // of entries of any type
};

}  // namespace fastcollide::search
