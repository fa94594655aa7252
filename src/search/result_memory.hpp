// Memory for results. What an earlier result had, and nobody holds any more, serves again: to ask the system for as
// much takes longer than to fill it.
#pragma once

#include <atomic>
#include <list>

#include "../backend/concept.hpp"

namespace fastcollide::search {

template <Backend B, class U>
class ResultMemory {
 public:
  using Buffer = typename B::template Buffer<U>;

  explicit ResultMemory(B& backend) : backend_(backend) {}

  // Room for `count` elements of a new result. It stays where it is until the next few calls.
  Buffer& take(std::int64_t count) {
    for (auto known = known_.begin(); known != known_.end();) {
      if (is_held(known->buffer)) {
        ++known;
      } else if (known->capacity >= count && known->capacity <= 4 * count + small) {
        std::atomic_thread_fence(std::memory_order_acquire);  // whoever held it has read what they wanted
        backend_.synchronize();                               // their kernels, too
        known->buffer.resize(count);
        known_.splice(known_.end(), known_, known);
        return known_.back().buffer;
      } else {
        known = known_.erase(known);
      }
    }
    if (known_.size() == most_known) known_.pop_front();  // it is its holder's alone from now on
    const std::int64_t capacity = count + count / 16;     // the next one may be a little longer
    known_.push_back({Buffer(backend_), capacity});
    known_.back().buffer.resize(capacity);
    known_.back().buffer.resize(count);
    return known_.back().buffer;
  }

 private:
  struct Known {
    Buffer buffer;
    std::int64_t capacity;
  };

  static bool is_held(const Buffer& buffer) { return buffer.share().use_count() > 2; }  // this one and that of share()

  // Two arrays of one type each in a result, the last of which is often held while the next one is found.
  static constexpr std::size_t most_known = 4;
  static constexpr std::int64_t small = 4096;

  B& backend_;
  std::list<Known> known_;
};

}  // namespace fastcollide::search
