// Work on CPU threads that may throw.
#pragma once

#include <algorithm>
#include <cstdint>
#include <exception>
#include <vector>

#include "../backend/thread_pool.hpp"

namespace fastcollide::search {

class Slabs {
 public:
  explicit Slabs(int threads) : threads_(threads) {}

  // How many slabs n things of some cost are worth: several for each thread even out those of different cost.
  int count(std::int64_t n, std::int64_t smallest, int for_each_thread) const {
    if (threads_ == 1) return 1;
    return static_cast<int>(std::clamp<std::int64_t>(n / smallest, 1, std::int64_t(for_each_thread) * threads_));
  }

  // work(slab, begin, end) on `slabs` parts of [0, n). Throws what a part has thrown.
  template <class Work>
  void run(int slabs, std::int64_t n, const Work& work) const {
    std::vector<std::exception_ptr> errors(static_cast<std::size_t>(slabs));
    run_slabs(threads_, slabs, [&](int slab) {
      try {
        work(slab, n * slab / slabs, n * (slab + 1) / slabs);
      } catch (...) {
        errors[static_cast<std::size_t>(slab)] = std::current_exception();
      }
    });
    for (const std::exception_ptr& error : errors) {
      if (error) std::rethrow_exception(error);
    }
  }

 private:
  int threads_;
};

}  // namespace fastcollide::search
