// Words that are found in no order and wanted bucket by bucket: each goes to the list of its bucket at once, so that it
// is written and read once before its bucket is laid out. Lists are chains of chunks; a thread has its own.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "../backend/cpu.hpp"
#include "point.hpp"

namespace fastcollide::search {

template <class Word>
class WordLists {
 public:
  explicit WordLists(CpuBackend& backend) : backend_(&backend) {}

  // Forgets all words; keeps the memory.
  void clear(std::int64_t buckets) {
    ends_.assign(static_cast<std::size_t>(buckets), nullptr);
    chunks_.clear();
    block_ = chunk_ = 0;
  }

  void release() { *this = WordLists(*backend_); }

  struct Entry {
    std::uint32_t bucket;
    Word word;
  };

  // Adds entry(0) ... entry(count - 1).
  template <class MakeEntry>
  void add(std::int64_t count, const MakeEntry& entry) {
    Word** const ends = ends_.data();
    for (std::int64_t k = 0; k < count; ++k) {
      const auto [bucket, word] = entry(k);
      Word* end = ends[bucket];
      // At the end of a chunk, which is where another could begin; or there is none yet.
      if (reinterpret_cast<std::uintptr_t>(end) % sizeof(Chunk) == 0) [[unlikely]]
        end = next_chunk(bucket);
      *end = word;
      ends[bucket] = end + 1;
    }
  }

  // Sorts the chunks by bucket. Then:
  void close() {
    const std::size_t buckets = ends_.size();
    starts_.assign(buckets + 1, 0);
    for (const Taken& chunk : chunks_) ++starts_[static_cast<std::size_t>(chunk.bucket) + 1];
    for (std::size_t bucket = 0; bucket < buckets; ++bucket) starts_[bucket + 1] += starts_[bucket];
    sorted_.resize(chunks_.size());
    std::vector<std::uint32_t> next(starts_.begin(), starts_.end() - 1);
    for (const Taken& chunk : chunks_) sorted_[next[static_cast<std::size_t>(chunk.bucket)]++] = chunk.words;
  }

  std::int64_t count(std::int64_t bucket) const {
    const auto b = static_cast<std::size_t>(bucket);
    if (starts_[b] == starts_[b + 1]) return 0;
    const std::int64_t full = std::int64_t(starts_[b + 1] - starts_[b] - 1) * chunk_words;
    return full + (ends_[b] - sorted_[starts_[b + 1] - 1]);
  }

  // visit(words, count) for each chunk.
  template <class Visit>
  void visit_words(std::int64_t bucket, const Visit& visit) const {
    const auto b = static_cast<std::size_t>(bucket);
    for (std::uint32_t k = starts_[b]; k < starts_[b + 1]; ++k) {
      const Word* words = sorted_[k];
      visit(words, k + 1 < starts_[b + 1] ? chunk_words : ends_[b] - words);
    }
  }

 private:
  static constexpr std::int64_t chunk_words = 256 / sizeof(Word);
  struct alignas(256) Chunk {
    Word words[chunk_words];
  };
  struct Taken {
    std::int64_t bucket;
    Word* words;
  };

  // From blocks that are never moved, each larger than the one before.
  Word* next_chunk(std::int64_t bucket) {
    if (block_ < blocks_.size() && chunk_ == blocks_[block_].size()) {
      ++block_;
      chunk_ = 0;
    }
    if (block_ == blocks_.size()) {
      constexpr std::int64_t smallest = 256, largest = 16384;  // 64 KiB to 4 MiB
      blocks_.emplace_back(*backend_);
      blocks_.back().resize(std::min(largest, smallest << 2 * std::min<std::size_t>(block_, 8)));
    }
    Word* words = blocks_[block_].data()[chunk_++].words;
    constexpr std::int64_t line_words = 64 / sizeof(Word);
    for (std::int64_t k = line_words; k < chunk_words; k += line_words) fetch_to_write(words + k);
    chunks_.push_back({bucket, words});
    return words;
  }

  CpuBackend* backend_;
  std::vector<CpuBackend::Buffer<Chunk>> blocks_;
  std::size_t block_ = 0;   // that chunks are taken from
  std::int64_t chunk_ = 0;  // the next one there
  std::vector<Taken> chunks_;
  std::vector<Word*> ends_;  // of each bucket, in its last chunk
  std::vector<std::uint32_t> starts_;
  std::vector<Word*> sorted_;
};

}  // namespace fastcollide::search
