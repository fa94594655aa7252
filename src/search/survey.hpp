// One look at all numbers of the input: is each in its range, where do the spheres lie, how large are they?
#pragma once

#include "search_grid.hpp"

namespace fastcollide::search {

enum class Bad : std::uint8_t { not_finite, radius, unresolved, outside, size };

inline constexpr std::uint64_t nothing_bad = ~std::uint64_t(0);

// A place must be given to 1/64 of the sphere's size: 2^17 sizes from 0 in float32, 2^46 in float64. (At that limit
// about one contact in a thousand is decided by the rounding of the positions.)
template <class T>
inline constexpr double reach_in_sizes = sizeof(T) == 4 ? 0x1p17 : 0x1p46;

// Squares of sizes in this range are normal numbers.
template <class T>
inline constexpr double smallest_size = sizeof(T) == 4 ? 1e-15 : 1e-140;
template <class T>
inline constexpr double largest_size = sizeof(T) == 4 ? 1e15 : 1e140;

template <class T>
struct Survey {
  std::uint64_t first_bad = nothing_bad;  // index * 8 + Bad
  double low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300};
  double least_size = 1e300, most_size = 0;  // radius + margin / 2

  struct Combine {
    FC_HOST_DEVICE Survey operator()(Survey a, const Survey& b) const {
      if (b.first_bad < a.first_bad) a.first_bad = b.first_bad;
      for (int axis = 0; axis < 3; ++axis) {
        if (b.low[axis] < a.low[axis]) a.low[axis] = b.low[axis];
        if (b.high[axis] > a.high[axis]) a.high[axis] = b.high[axis];
      }
      if (b.least_size < a.least_size) a.least_size = b.least_size;
      if (b.most_size > a.most_size) a.most_size = b.most_size;
      return a;
    }
  };
};

template <class T>
FC_HOST_DEVICE inline bool is_finite_number(T x) {
  return x - x == T(0);
}

// Spheres are looked at in groups: a CPU thread likes long ones, the threads of a GPU take one each.
struct Groups {
  std::int64_t count, size;

  FC_HOST_DEVICE std::int64_t groups() const { return (count + size - 1) / size; }
  FC_HOST_DEVICE std::int64_t begin(std::int64_t group) const { return group * size; }
  FC_HOST_DEVICE std::int64_t end(std::int64_t group) const {
    return (group + 1) * size < count ? (group + 1) * size : count;
  }
};

inline constexpr int quick_group = 64;

template <class T>
struct SurveySpheres {
  SpheresIn<T> spheres;
  Groups groups;
  double half_margin;
  Bounds<T> bounds;

  FC_HOST_DEVICE Survey<T> operator()(std::int64_t group) const {
    Survey<T> survey;
    const std::int64_t begin = groups.begin(group), end = groups.end(group);
    if (end - begin == quick_group && spheres.position_step == 3 && spheres.component_step == 1 &&
        spheres.radii == nullptr && add_group(spheres.positions + 3 * begin, survey)) {
      return survey;
    }
    for (std::int64_t i = begin; i < end; ++i) add(i, survey);
    return survey;
  }

  // A whole group of spheres of one size that lie side by side in memory, in loops that become vector instructions.
  // False where one of them may be bad: then each is looked at.
  FC_HOST_DEVICE bool add_group(const T* numbers, Survey<T>& survey) const {
    constexpr int lanes = 24;  // a multiple of 3: each lane has one axis; more than compilers unroll
    T low[lanes], high[lanes], wrong[lanes] = {};
    for (int lane = 0; lane < lanes; ++lane) low[lane] = high[lane] = numbers[lane];
    for (int k = 0; k < 3 * quick_group; k += lanes) {
      for (int lane = 0; lane < lanes; ++lane) {
        const T x = numbers[k + lane];
        low[lane] = x < low[lane] ? x : low[lane];
        high[lane] = x > high[lane] ? x : high[lane];
        wrong[lane] += x - x;  // NaN for ever after a number that is not finite
      }
    }
    bool is_good = half_margin >= smallest_size<T> && half_margin <= largest_size<T>;
    for (int lane = 0; lane < lanes; ++lane) {
      const int axis = lane % 3;
      is_good = is_good && wrong[lane] == T(0) && static_cast<double>(high[lane]) <= reach_in_sizes<T> * half_margin &&
                static_cast<double>(low[lane]) >= -reach_in_sizes<T> * half_margin &&
                (!bounds.is_periodic[axis] || (low[lane] >= bounds.lower[axis] && high[lane] <= bounds.upper[axis]));
      if (low[lane] < survey.low[axis]) survey.low[axis] = low[lane];
      if (high[lane] > survey.high[axis]) survey.high[axis] = high[lane];
    }
    survey.least_size = survey.most_size = half_margin;
    if (!is_good) survey = Survey<T>{};
    return is_good;
  }

  FC_HOST_DEVICE void add(std::int64_t i, Survey<T>& survey) const {
    const auto bad = [&](Bad kind) {
      const std::uint64_t word = static_cast<std::uint64_t>(i) * 8 + static_cast<std::uint64_t>(kind);
      if (word < survey.first_bad) survey.first_bad = word;
    };
    const Point<T> p = spheres.position(i);
    const T radius = spheres.radius(i);
    if (!(is_finite_number(p.x) && is_finite_number(p.y) && is_finite_number(p.z))) return bad(Bad::not_finite);
    if (!(radius >= T(0) && is_finite_number(radius))) return bad(Bad::radius);
    const double size = static_cast<double>(radius) + half_margin;
    if (size > 0 && !(size >= smallest_size<T> && size <= largest_size<T>)) return bad(Bad::size);
    const T place[3] = {p.x, p.y, p.z};
    for (int axis = 0; axis < 3; ++axis) {
      const double x = place[axis];
      if (size > 0 && fabs(x) > reach_in_sizes<T> * size) return bad(Bad::unresolved);
      if (bounds.is_periodic[axis] && !(place[axis] >= bounds.lower[axis] && place[axis] <= bounds.upper[axis])) {
        return bad(Bad::outside);
      }
      if (x < survey.low[axis]) survey.low[axis] = x;
      if (x > survey.high[axis]) survey.high[axis] = x;
    }
    if (size < survey.least_size) survey.least_size = size;
    if (size > survey.most_size) survey.most_size = size;
  }
};

// How many spheres there are of each size, by powers of two.
struct OctaveCounts {
  std::int64_t counts[octaves] = {};

  struct Combine {
    FC_HOST_DEVICE OctaveCounts operator()(OctaveCounts a, const OctaveCounts& b) const {
      for (int octave = 0; octave < octaves; ++octave) a.counts[octave] += b.counts[octave];
      return a;
    }
  };
};

template <class T>
struct CountOctaves {
  SpheresIn<T> spheres;
  Groups groups;
  double half_margin;
  int base_exponent;

  FC_HOST_DEVICE OctaveCounts operator()(std::int64_t group) const {
    OctaveCounts counts;
    const std::int64_t end = groups.end(group);
    for (std::int64_t i = groups.begin(group); i < end; ++i) {
      ++counts.counts[octave_of(static_cast<double>(spheres.radius(i)) + half_margin, base_exponent)];
    }
    return counts;
  }
};

}  // namespace fastcollide::search
