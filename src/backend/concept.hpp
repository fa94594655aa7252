// What a stage may ask of a device, and all it may know of one. Both backends give the same values: a stage written
// against this page runs unchanged, with the same bits, on any number of CPU threads and on CUDA at any block size.
#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "../math.hpp"
#include "lane.hpp"

namespace fastcollide {

// A functor that the concept check hands to for_each and transform_reduce.
struct ConceptProbe {
  FC_HOST_DEVICE void operator()(std::int64_t) const {}
};
struct ConceptProbeValue {
  FC_HOST_DEVICE std::int64_t operator()(std::int64_t i) const { return i; }
};

struct ConceptProbePass {
  struct Sum {
    FC_HOST_DEVICE bool is_empty() const { return true; }
    FC_HOST_DEVICE void combine(const Sum&) {}
    std::uint32_t word;
  };
  FC_HOST_DEVICE Sum gather(std::int64_t, Lane) const { return {}; }
  FC_HOST_DEVICE void finish(std::int64_t, const Sum&) const {}
  FC_HOST_DEVICE void operator()(std::int64_t) const {}
};

struct Sum {
  template <class T>
  FC_HOST_DEVICE T operator()(T a, T b) const {
    return a + b;
  }
};

template <class B>
concept Backend = requires(B backend, typename B::template Buffer<std::uint32_t> buffer, std::uint32_t* words,
                           std::int64_t* counts, std::int64_t n, int bits) {
  // Buffer<T>: device memory that grows and keeps its content; data(), size(), resize(n). Throws OutOfMemory.
  // share() keeps the memory alive for someone outside.
  { buffer.data() } -> std::same_as<std::uint32_t*>;
  { buffer.share() } -> std::same_as<std::shared_ptr<void>>;
  { buffer.size() } -> std::convertible_to<std::int64_t>;
  buffer.resize(n);
  // for_each(n, f): f(i) for each i in [0, n), in any order and at the same time. f is a struct with a const
  // FC_HOST_DEVICE operator()(std::int64_t) and is copied to the device: plain pointers and numbers only.
  backend.for_each(n, ConceptProbe{});
  // A contact pass over groups of slots.
  backend.for_each_of_groups(SlotGroups{}, ConceptProbePass{});
  // Sum (or another associative, commutative operation that is exact) of f(i) over [0, n).
  { backend.transform_reduce(n, ConceptProbeValue{}, std::int64_t(0), Sum{}) } -> std::same_as<std::int64_t>;
  // Replaces each of the n counts by the sum of those before it, and counts[n], one past the last, by the total.
  backend.exclusive_scan(counts, n);
  backend.exclusive_scan(words, n);
  // The same from n counts, with any number behind them, to n + 1 sums.
  backend.exclusive_scan(static_cast<const std::uint32_t*>(words), words, n);
  // Stable sort of (key, value) by the lowest `bits` of the key.
  backend.sort_pairs(static_cast<const std::uint32_t*>(words), words, static_cast<const std::uint32_t*>(words), words,
                     n, bits);
  backend.fill_zero(words, n);
  backend.copy(words, static_cast<const std::uint32_t*>(words), n);  // within the device
  backend.copy_to_device(words, static_cast<const std::uint32_t*>(words), n);
  backend.copy_to_host(words, static_cast<const std::uint32_t*>(words), n);
  // Stages may still run when the call that started them returns; after copy_to_host() and synchronize() none does.
  backend.synchronize();
  // Nothing starts before the caller's stream has done what is queued there, or ends after what will be. No-op on a
  // CPU.
  backend.wait_for(static_cast<void*>(nullptr));
  backend.let_wait(static_cast<void*>(nullptr));
  { backend.cuda_device() } -> std::same_as<int>;  // where buffers lie: -1 is host memory
  { B::frames_between_checks } -> std::convertible_to<std::int64_t>;
  // Lists that are walked at the same time, and so better lie interleaved.
  { B::list_width } -> std::convertible_to<std::uint32_t>;
  // Whether there is run_on_whole_grid<lanes>(n, program): see backend/grid_run.cuh.
  { B::has_whole_grid } -> std::convertible_to<bool>;
};

}  // namespace fastcollide
