// Sorts one row in place without extra memory: heap sort, as a row may have tens of thousands of entries. The caller's
// functions compare and exchange two places, so that several arrays can be sorted together.
#pragma once

#include "../math.hpp"

namespace fastcollide::search {

template <class T>
FC_HOST_DEVICE inline void exchange(T& a, T& b) {
  const T held = a;
  a = b;
  b = held;
}

template <class Less, class Swap>
FC_HOST_DEVICE inline void sort_row(std::int64_t count, const Less& less, const Swap& swap) {
  const auto sift_down = [&](std::int64_t root, std::int64_t end) {
    for (std::int64_t child; (child = 2 * root + 1) < end; root = child) {
      if (child + 1 < end && less(child, child + 1)) ++child;
      if (!less(root, child)) return;
      swap(root, child);
    }
  };
  for (std::int64_t root = count / 2; root-- > 0;) sift_down(root, count);
  for (std::int64_t end = count - 1; end > 0; --end) {
    swap(0, end);
    sift_down(0, end);
  }
}

}  // namespace fastcollide::search
