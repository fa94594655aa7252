// Small vectors, exact sums and the one host/device macro. Every function here gives the same bits on every
// device: only IEEE 754 operations that are correctly rounded everywhere (+ - * / sqrt floor, conversions), no
// contraction (see the build flags), no libm transcendental.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>

#if defined(__CUDACC__)
#define FC_HOST_DEVICE __host__ __device__
// Before a template that calls only host functions when it runs on the host, and only device functions on the device.
#define FC_EITHER_SIDE _Pragma("nv_exec_check_disable")
// Loops that a GPU had better run as written out, or as a loop.
#define FC_UNROLL _Pragma("unroll")
#define FC_NO_UNROLL _Pragma("unroll 1")
#else
#define FC_HOST_DEVICE
#define FC_EITHER_SIDE
#define FC_UNROLL
#define FC_NO_UNROLL
#include <atomic>
#endif

namespace fastcollide {

struct Vec3 {
  float x, y, z;
};

struct Vec3i {
  int x, y, z;
};

struct alignas(16) Vec4 {
  float x, y, z, w;
};

FC_HOST_DEVICE inline Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
FC_HOST_DEVICE inline Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
FC_HOST_DEVICE inline Vec3 operator-(Vec3 a) { return {-a.x, -a.y, -a.z}; }
FC_HOST_DEVICE inline Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
FC_HOST_DEVICE inline float dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
FC_HOST_DEVICE inline Vec3 cross(Vec3 a, Vec3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
FC_HOST_DEVICE inline float square_root(float x) {
#if defined(__CUDA_ARCH__)
  return __fsqrt_rn(x);
#else
  return std::sqrt(x);
#endif
}
// On a GPU it may be wrong by 2^-22 of itself: for what changes no result.
FC_HOST_DEVICE inline float rough_square_root(float x) {
#if defined(__CUDA_ARCH__)
  float root;
  asm("sqrt.approx.f32 %0, %1;" : "=f"(root) : "f"(x));
  return root;
#else
  return square_root(x);
#endif
}

FC_HOST_DEVICE inline float length(Vec3 a) { return square_root(dot(a, a)); }

// Written as comparisons, so that a NaN gives the second argument on every device.
FC_HOST_DEVICE inline float smaller(float a, float b) { return a < b ? a : b; }
FC_HOST_DEVICE inline float larger(float a, float b) { return a > b ? a : b; }
FC_HOST_DEVICE inline float clamp(float x, float low, float high) { return larger(smaller(x, high), low); }

// True for neither infinities nor NaN; holds also where a host compiler would fold std::isfinite away.
FC_HOST_DEVICE inline bool is_finite(float x) { return x - x == 0.0f; }
FC_HOST_DEVICE inline bool is_finite(Vec3 a) { return is_finite(a.x) && is_finite(a.y) && is_finite(a.z); }

FC_HOST_DEVICE inline std::uint32_t bits_of(float x) {
  std::uint32_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}
FC_HOST_DEVICE inline float float_of(std::uint32_t bits) {
  float x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

// Finalizer of splitmix64 (Steele, Lea, Flood 2014): a bijection of 64-bit words in which every input bit moves every
// output bit.
FC_HOST_DEVICE inline std::uint64_t mix64(std::uint64_t z) {
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

// Round to nearest, ties to even; the caller keeps |x| below 2^51.
FC_HOST_DEVICE inline std::int64_t round_to_int64(float x) {
#if defined(__CUDA_ARCH__)
  return __float2ll_rn(x);
#else
  // The sum has no place for a fraction, and its lowest bits are the integer: a form that vector units have.
  constexpr double shift = 0x1.8p52;
  return std::bit_cast<std::int64_t>(static_cast<double>(x) + shift) - std::bit_cast<std::int64_t>(shift);
#endif
}
// Likewise; the caller keeps |x| below 2^31. Much cheaper than 64 bits on a GPU.
FC_HOST_DEVICE inline std::int32_t round_to_int32(float x) {
#if defined(__CUDA_ARCH__)
  return __float2int_rn(x);
#else
  return static_cast<std::int32_t>(round_to_int64(x));
#endif
}
FC_HOST_DEVICE inline std::int64_t round_to_int64(double x) {
#if defined(__CUDA_ARCH__)
  return __double2ll_rn(x);
#else
  return std::llrint(x);
#endif
}

#if defined(__CUDACC__)
template <class Word>  // as CUDA's atomics name it
using CudaWord = std::conditional_t<sizeof(Word) == 8, unsigned long long, unsigned int>;
#endif

// Lowers *target to value, from any thread at once. Which thread comes last never matters: the smallest value wins.
FC_HOST_DEVICE inline void atomic_min(std::uint64_t* target, std::uint64_t value) {
#if defined(__CUDA_ARCH__)
  atomicMin(reinterpret_cast<unsigned long long*>(target), static_cast<unsigned long long>(value));
#elif !defined(__CUDACC__)
  std::atomic_ref<std::uint64_t> shared(*target);
  std::uint64_t seen = shared.load(std::memory_order_relaxed);
  while (value < seen && !shared.compare_exchange_weak(seen, value, std::memory_order_relaxed)) {
  }
#else
  if (value < *target) *target = value;  // host pass of nvcc: compiled, never run
#endif
}

// Likewise: raises *target to value; adds to it and returns what it was. Integers of 32 or 64 bits, whose sum needs no
// order either.
template <class Word>
FC_HOST_DEVICE inline void atomic_max(Word* target, std::type_identity_t<Word> value) {
#if defined(__CUDA_ARCH__)
  if (value <= *static_cast<volatile Word*>(target)) return;  // most values are below what is there
  atomicMax(reinterpret_cast<CudaWord<Word>*>(target), static_cast<CudaWord<Word>>(value));
#elif !defined(__CUDACC__)
  std::atomic_ref<Word> shared(*target);
  Word seen = shared.load(std::memory_order_relaxed);
  while (value > seen && !shared.compare_exchange_weak(seen, value, std::memory_order_relaxed)) {
  }
#else
  if (value > *target) *target = value;  // host pass of nvcc: compiled, never run
#endif
}
template <class Word>
FC_HOST_DEVICE inline Word atomic_add(Word* target, std::type_identity_t<Word> value) {
#if defined(__CUDA_ARCH__)
  return static_cast<Word>(atomicAdd(reinterpret_cast<CudaWord<Word>*>(target), static_cast<CudaWord<Word>>(value)));
#elif !defined(__CUDACC__)
  return std::atomic_ref<Word>(*target).fetch_add(value, std::memory_order_relaxed);
#else
  return (*target += value) - value;  // host pass of nvcc: by one thread
#endif
}

// What is there while others may change it.
template <class Word>
FC_HOST_DEVICE inline Word atomic_read(Word* source) {
#if defined(__CUDACC__)
  return *static_cast<volatile Word*>(source);
#else
  return std::atomic_ref<Word>(*source).load(std::memory_order_relaxed);
#endif
}

// Puts a value in and returns what was there.
template <class Word>
FC_HOST_DEVICE inline Word atomic_exchange(Word* target, std::type_identity_t<Word> value) {
#if defined(__CUDA_ARCH__)
  return static_cast<Word>(atomicExch(reinterpret_cast<CudaWord<Word>*>(target), static_cast<CudaWord<Word>>(value)));
#elif !defined(__CUDACC__)
  return std::atomic_ref<Word>(*target).exchange(value, std::memory_order_relaxed);
#else
  const Word found = *target;
  *target = value;  // host pass of nvcc: by one thread
  return found;
#endif
}
// Likewise, but only where there is what is expected; returns what was there.
template <class Word>
FC_HOST_DEVICE inline Word atomic_compare_exchange(Word* target, std::type_identity_t<Word> expected,
                                                   std::type_identity_t<Word> value) {
#if defined(__CUDA_ARCH__)
  return static_cast<Word>(atomicCAS(reinterpret_cast<CudaWord<Word>*>(target), static_cast<CudaWord<Word>>(expected),
                                     static_cast<CudaWord<Word>>(value)));
#elif !defined(__CUDACC__)
  std::atomic_ref<Word>(*target).compare_exchange_strong(expected, value, std::memory_order_relaxed);
  return expected;
#else
  const Word found = *target;
  if (found == expected) *target = value;  // host pass of nvcc: by one thread
  return found;
#endif
}

// The lowest of the bits that are set; there is one.
FC_HOST_DEVICE inline int lowest_bit(std::uint32_t bits) {
#if defined(__CUDA_ARCH__)
  return __ffs(static_cast<int>(bits)) - 1;
#else
  return std::countr_zero(bits);
#endif
}

// -------------------------------------------------------------------------------------------------------------------
// Sums that do not depend on the order of their terms. Each term is rounded once to a multiple of a power of two and
// the integers are added, so neighbour order, threads, lanes and atomics give the same bits.
//
// A term may be as large as `range` and a sum may have `max_terms` of them; a term outside the range is cut to it and
// reported (`saturated`), never wrapped. Resolution: range / 2^41.

inline constexpr std::uint32_t max_terms = 1u << 21;

struct FixedPoint {
  float scale;  // 2^41 / range, a power of two
  float unit;   // 1 / scale
};

#if defined(FASTCOLLIDE_FREE_ORDER)
inline constexpr bool sums_are_integers = false;
// Only to measure what exact sums cost: the order of the terms decides the last bits.
struct ExactSum3 {
  float x = 0, y = 0, z = 0;
};
FC_HOST_DEVICE inline bool add_exactly(ExactSum3& sum, Vec3 term, FixedPoint) {
  sum.x += term.x;
  sum.y += term.y;
  sum.z += term.z;
  return true;
}
FC_HOST_DEVICE inline Vec3 value_of(ExactSum3 sum, FixedPoint) { return {sum.x, sum.y, sum.z}; }
#else
inline constexpr bool sums_are_integers = true;
struct ExactSum3 {
  std::int64_t x = 0, y = 0, z = 0;
};

// Returns false when a component was outside the range (or NaN).
FC_HOST_DEVICE inline bool add_exactly(std::int64_t& sum, float term, FixedPoint fixed) {
  constexpr float limit = 2199023255552.0f;  // 2^41
  const float scaled = term * fixed.scale;
  const float cut = clamp(scaled, -limit, limit);
  sum += round_to_int64(cut);
  return fabsf(scaled) <= limit;
}
FC_HOST_DEVICE inline bool add_exactly(ExactSum3& sum, Vec3 term, FixedPoint fixed) {
  const bool x = add_exactly(sum.x, term.x, fixed);
  const bool y = add_exactly(sum.y, term.y, fixed);
  const bool z = add_exactly(sum.z, term.z, fixed);
  return x & y & z;
}
FC_HOST_DEVICE inline Vec3 value_of(ExactSum3 sum, FixedPoint fixed) {
  return {static_cast<float>(sum.x) * fixed.unit, static_cast<float>(sum.y) * fixed.unit,
          static_cast<float>(sum.z) * fixed.unit};
}
#endif
FC_HOST_DEVICE inline void add(ExactSum3& sum, const ExactSum3& other) {
  sum.x += other.x;
  sum.y += other.y;
  sum.z += other.z;
}

// The finest scale whose range covers `range` (> 0).
inline FixedPoint fixed_point_for(float range) {
  int exponent = 0;
  std::frexp(range, &exponent);  // range <= 2^exponent
  return {std::ldexp(1.0f, 41 - exponent), std::ldexp(1.0f, exponent - 41)};
}

}  // namespace fastcollide
