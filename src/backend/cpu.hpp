// The backend on CPU threads: slabs of work, run by a shared pool.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <type_traits>
#include <vector>

#include "../math.hpp"
#include "concept.hpp"
#include "fastcollide/errors.hpp"
#include "large_memory.hpp"
#include "thread_pool.hpp"

namespace fastcollide {

class CpuBackend {
 public:
  // Memory that outlives its buffer while someone holds share(): arrays handed to Python stay valid.
  template <class T>
  class Buffer {
    static_assert(std::is_trivially_copyable_v<T>);

   public:
    explicit Buffer(CpuBackend&) {}
    Buffer(Buffer&&) noexcept = default;
    Buffer& operator=(Buffer&&) noexcept = default;
    T* data() { return memory_.get(); }
    const T* data() const { return memory_.get(); }
    std::int64_t size() const { return size_; }
    std::shared_ptr<void> share() const { return memory_; }

    // Keeps the first min(size, count) elements; the others are undefined. Grows at least by half.
    void resize(std::int64_t count) {
      if (count > capacity_) {
        const std::int64_t capacity = capacity_ == 0 ? count : std::max(count, capacity_ + capacity_ / 2);
        std::shared_ptr<T[]> memory;
        try {
          memory = allocate(static_cast<std::size_t>(capacity));
        } catch (const std::bad_alloc&) {
          throw OutOfMemory("out of memory on the CPU: " + std::to_string(count * std::int64_t(sizeof(T))) +
                            " bytes more are needed");
        }
        if (size_ > 0) std::memcpy(memory.get(), memory_.get(), static_cast<std::size_t>(size_) * sizeof(T));
        memory_ = std::move(memory);
        capacity_ = capacity;
      }
      size_ = count;
    }

   private:
    static std::shared_ptr<T[]> allocate(std::size_t count) {
      if (count > SIZE_MAX / sizeof(T)) throw std::bad_alloc();
      if (count * sizeof(T) < large_memory) return std::shared_ptr<T[]>(new T[count]);
      void* memory = allocate_large(count * sizeof(T));
      if (memory == nullptr) throw std::bad_alloc();
      return std::shared_ptr<T[]>(static_cast<T*>(memory), release_large);
    }

    std::shared_ptr<T[]> memory_;
    std::int64_t size_ = 0, capacity_ = 0;
  };

  static constexpr std::int64_t frames_between_checks = 1;
  static constexpr std::uint32_t list_width = 1;
  static constexpr bool has_whole_grid = false;

  explicit CpuBackend(int threads) : threads_(threads) {}
  static int cuda_device() { return -1; }
  int threads() const { return threads_; }

  template <class F>
  void for_each(std::int64_t n, const F& f) {
    for_each_slab(n, [&](int, std::int64_t begin, std::int64_t end) { run_part(f, begin, end); });
  }

  // One sphere that is worth many lanes is a slab of its own.
  template <class Pass>
  void for_each_of_groups(const SlotGroups& groups, const Pass& pass) {
    for (int k = 0; k < groups.count; ++k) {
      const auto [first, count, lanes] = groups.groups[k];
      if (lanes == 1) {
        for_each(count, [&pass, begin = first](std::int64_t i) { pass(begin + i); });
        continue;
      }
      const std::int64_t slabs = std::min<std::int64_t>(count, 4096);
      run_slabs(threads_, static_cast<int>(slabs), [&, begin = first, all = count](int slab) {
        for (std::int64_t i = all * slab / slabs; i < all * (slab + 1) / slabs; ++i) pass(begin + i);
      });
    }
  }

  template <class F, class T, class Operation>
  T transform_reduce(std::int64_t n, const F& f, T identity, Operation combine) {
    std::vector<T> partial(static_cast<std::size_t>(slab_count(n)), identity);
    for_each_slab(n, [&](int slab, std::int64_t begin, std::int64_t end) {
      T value = identity;
      for (std::int64_t i = begin; i < end; ++i) value = combine(value, f(i));
      partial[static_cast<std::size_t>(slab)] = value;
    });
    T value = identity;
    for (const T& one : partial) value = combine(value, one);
    return value;
  }

  template <class Count>
  void exclusive_scan(Count* counts, std::int64_t n) {
    exclusive_scan(static_cast<const Count*>(counts), counts, n);
  }
  template <class Count>
  void exclusive_scan(const Count* counts, Count* sums, std::int64_t n) {
    const std::size_t slabs = static_cast<std::size_t>(slab_count(n));
    std::vector<Count> offset(slabs + 1, 0);
    for_each_slab(n, [&](int slab, std::int64_t begin, std::int64_t end) {
      Count sum = 0;
      for (std::int64_t i = begin; i < end; ++i) sum += counts[i];
      offset[static_cast<std::size_t>(slab) + 1] = sum;
    });
    for (std::size_t slab = 0; slab < slabs; ++slab) offset[slab + 1] += offset[slab];
    const Count total = offset.back();
    for_each_slab(n, [&](int slab, std::int64_t begin, std::int64_t end) {
      Count sum = offset[static_cast<std::size_t>(slab)];
      for (std::int64_t i = begin; i < end; ++i) {
        const Count value = counts[i];
        sums[i] = sum;
        sum += value;
      }
    });
    sums[n] = total;
  }

  // Least-significant-digit radix sort: each slab counts its digits, the counts give every slab its places.
  void sort_pairs(const std::uint32_t* keys_in, std::uint32_t* keys_out, const std::uint32_t* values_in,
                  std::uint32_t* values_out, std::int64_t n, int bits) {
    constexpr int digit_bits = 11;
    const int passes = std::max(1, (bits + digit_bits - 1) / digit_bits);
    sort_keys_.resize(n);
    sort_values_.resize(n);
    const std::uint32_t* from_keys = keys_in;
    const std::uint32_t* from_values = values_in;
    for (int pass = 0; pass < passes; ++pass) {
      // The last pass must end in the output: count back from it.
      const bool to_output = (passes - 1 - pass) % 2 == 0;
      std::uint32_t* to_keys = to_output ? keys_out : sort_keys_.data();
      std::uint32_t* to_values = to_output ? values_out : sort_values_.data();
      sort_by_digit<digit_bits>(from_keys, to_keys, from_values, to_values, n, pass * digit_bits);
      from_keys = to_keys;
      from_values = to_values;
    }
  }

  template <class T>
  void fill_zero(T* data, std::int64_t n) {
    if (n > 0) std::memset(data, 0, static_cast<std::size_t>(n) * sizeof(T));
  }
  template <class T>
  void copy(T* to, const T* from, std::int64_t n) {
    if (n > 0) std::memcpy(to, from, static_cast<std::size_t>(n) * sizeof(T));
  }
  template <class T>
  void copy_to_device(T* device, const T* host, std::int64_t n) {
    copy(device, host, n);
  }
  template <class T>
  void copy_to_host(T* host, const T* device, std::int64_t n) {
    copy(host, device, n);
  }
  void synchronize() {}
  void wait_for(void*) {}
  void let_wait(void*) {}

 private:
  // One function with all that f calls: GCC leaves the passes' smaller functions out of line otherwise.
  template <class F>
  [[gnu::flatten]] static void run_part(const F& f, std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) f(i);
  }

  // work(slab, begin, end) on slabs that depend on n alone, so that two calls with the same n cut it alike. Several for
  // each thread even out slabs of different cost; a slab has enough elements to be worth handing over.
  template <class Work>
  void for_each_slab(std::int64_t n, const Work& work) {
    const std::int64_t slabs = slab_count(n);
    run_slabs(threads_, static_cast<int>(slabs),
              [&](int slab) { work(slab, n * slab / slabs, n * (slab + 1) / slabs); });
  }
  std::int64_t slab_count(std::int64_t n) const {
    constexpr std::int64_t slabs_per_thread = 4, smallest_slab = 256;
    if (threads_ == 1) return 1;
    return std::clamp<std::int64_t>(n / smallest_slab, 1, slabs_per_thread * threads_);
  }

  template <int digit_bits>
  void sort_by_digit(const std::uint32_t* keys_in, std::uint32_t* keys_out, const std::uint32_t* values_in,
                     std::uint32_t* values_out, std::int64_t n, int shift) {
    constexpr std::uint32_t digits = 1u << digit_bits;
    using Counts = std::array<std::int64_t, digits>;
    std::vector<Counts> places(static_cast<std::size_t>(slab_count(n)), Counts{});
    for_each_slab(n, [&](int slab, std::int64_t begin, std::int64_t end) {
      Counts& count = places[static_cast<std::size_t>(slab)];
      for (std::int64_t i = begin; i < end; ++i) ++count[(keys_in[i] >> shift) & (digits - 1)];
    });
    std::int64_t place = 0;
    for (std::uint32_t digit = 0; digit < digits; ++digit) {
      for (Counts& count : places) {
        const std::int64_t here = count[digit];
        count[digit] = place;
        place += here;
      }
    }
    for_each_slab(n, [&](int slab, std::int64_t begin, std::int64_t end) {
      Counts& next = places[static_cast<std::size_t>(slab)];
      for (std::int64_t i = begin; i < end; ++i) {
        const std::int64_t to = next[(keys_in[i] >> shift) & (digits - 1)]++;
        keys_out[to] = keys_in[i];
        values_out[to] = values_in[i];
      }
    });
  }

  int threads_;
  Buffer<std::uint32_t> sort_keys_{*this}, sort_values_{*this};
};

}  // namespace fastcollide
