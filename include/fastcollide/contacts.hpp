// Which spheres touch, which points are near: the engine's search for anyone's arrays.
#pragma once

#include <array>
#include <concepts>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>

#include "fastcollide/array_view.hpp"
#include "fastcollide/boundary.hpp"
#include "fastcollide/errors.hpp"

namespace fastcollide {

// Numbers where they lie: `rows` vectors or scalars of float32 or float64, in the memory of the host or of a CUDA
// device, with any steps between them. Nothing is copied or kept.
struct ConstArray {
  const void* data = nullptr;
  bool is_double = false;
  std::int64_t rows = 0;
  std::int64_t row_step = 1, column_step = 1;  // elements from one row, or component, to the next
  int cuda_device = -1;                        // -1: host memory
};

// x, y, z of each point, one after the other.
template <std::floating_point T>
ConstArray points(std::span<const T> values, int cuda_device = -1) {
  static_assert(sizeof(T) == 4 || sizeof(T) == 8);
  return {values.data(), sizeof(T) == 8, static_cast<std::int64_t>(values.size() / 3), 3, 1, cuda_device};
}
template <std::floating_point T>
ConstArray scalars(std::span<const T> values, int cuda_device = -1) {
  static_assert(sizeof(T) == 4 || sizeof(T) == 8);
  return {values.data(), sizeof(T) == 8, static_cast<std::int64_t>(values.size()), 1, 1, cuda_device};
}

// Spheres of one radius each, or all of the same.
struct SphereArrays {
  ConstArray positions;  // (n, 3)
  ConstArray radii;      // (n,), of the same type and device; without data all have the radius below
  double radius = 0;
};

struct SearchOptions {
  // Two spheres are found when d² < (r₁ + r₂ + margin)², every operation in double precision. Where surfaces just meet
  // the margin they are not found, unless `is_inclusive`.
  double margin = 0;
  bool is_inclusive = false;
  // Along a periodic axis positions lie in [lower, upper] and distances are taken to the nearest image; a wall is no
  // sphere and counts as open.
  std::array<Boundary, 3> boundary{Boundary::open, Boundary::open, Boundary::open};
  std::array<double, 3> lower{}, upper{};
  std::int64_t most_contacts = std::numeric_limits<std::int64_t>::max();  // a longer list is refused
  void* cuda_stream = nullptr;  // of the caller: the search starts after what is queued there, and that waits for it
};

struct NeighborOptions {
  bool keep_distances = false;                                             // measure each
  bool is_squared = false;                                                 // d² in place of d
  bool sort_by_distance = false;                                           // else by index
  std::int64_t most_neighbors = std::numeric_limits<std::int64_t>::max();  // of a point: the nearest are kept
};

// New memory on the device of the input, owned by each view. Indices are int32, offsets and counts int64, gaps, normals
// and distances of the input's type.
struct ContactList {
  ArrayView first, second;  // first < second in one set; of two sets: first of the one, second of the other; sorted
  ArrayView gap;            // distance of the surfaces, negative in overlap
  ArrayView normal;         // from first to second, unit length; (-1, 0, 0) where the centres coincide
};

// Compressed rows: the neighbours of i are indices[offsets[i]] ... indices[offsets[i + 1] - 1].
struct NeighborList {
  ArrayView offsets, indices;
  ArrayView distances;              // empty unless asked for
  std::int64_t shortened_rows = 0;  // points that had more than most_neighbors
};

class ContactEngines;

// Keeps its working memory from call to call. It searches where the arrays lie; threads that share one take turns.
// Errors of all searches: InvalidValue (a number that is not finite, a negative radius, arrays that do not fit
// together, a place that the input's type cannot resolve to 1/64 of a radius), OutOfMemory, DeviceError.
//
// For spheres that move little from call to call it can keep candidates: all pairs whose surfaces are less than the
// skin beyond the margin. As long as no two spheres can have come closer by more than the skin, which each call checks,
// later calls look at the candidates alone; else the list is made anew. The result is the same, bit for bit. One kind
// of list of one set of spheres (or pair of sets) is kept at a time: neighbors() needs another one than the other
// calls.
class ContactFinder {
 public:
  explicit ContactFinder(int threads = 0, double skin = 0);  // threads of the CPU, 0: all; skin 0: keep no candidates
  ~ContactFinder();
  ContactFinder(ContactFinder&&) noexcept;
  ContactFinder& operator=(ContactFinder&&) noexcept;

  // Pairs within one set, or of one from each of two.
  std::int64_t count(const SphereArrays& spheres, const SearchOptions& options = {},
                     const SphereArrays* others = nullptr);
  // Contacts of each sphere, int64.
  ArrayView counts(const SphereArrays& spheres, const SearchOptions& options = {},
                   const SphereArrays* others = nullptr);
  ContactList pairs(const SphereArrays& spheres, const SearchOptions& options = {},
                    const SphereArrays* others = nullptr);  // without gap and normal
  ContactList contacts(const SphereArrays& spheres, const SearchOptions& options = {},
                       const SphereArrays* others = nullptr);
  // Of each sphere, all that it touches (of `others`, if given).
  NeighborList neighbors(const SphereArrays& spheres, const SearchOptions& options = {},
                         const SphereArrays* others = nullptr, const NeighborOptions& list = {});

  // How many calls have looked at kept candidates alone.
  std::int64_t reuses() const;

  // For tests: the form that is written against the backend concept, as it runs on a GPU.
  void use_generic_form(bool is_generic);

 private:
  std::unique_ptr<ContactEngines> engines_;
};

}  // namespace fastcollide
