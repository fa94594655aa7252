// Python's view of fastcollide/contacts.hpp.
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <optional>
#include <tuple>

#include "fastcollide/contacts.hpp"
#include "fastcollide/devices.hpp"
#include "share.hpp"

namespace fastcollide::python {
namespace {

using namespace nb::literals;

// (address, is_double, rows, row step, column step, CUDA device or -1); Python holds the array while it is in use.
using Described = std::tuple<std::uintptr_t, bool, std::int64_t, std::int64_t, std::int64_t, int>;

ConstArray array_of(const Described& d) {
  const auto& [address, is_double, rows, row_step, column_step, device] = d;
  return {reinterpret_cast<const void*>(address), is_double, rows, row_step, column_step, device};
}

// Radii are an array or one number for all.
using Radii = std::tuple<std::optional<Described>, double>;

SphereArrays spheres_of(const Described& positions, const Radii& radii) {
  SphereArrays spheres;
  spheres.positions = array_of(positions);
  if (std::get<0>(radii)) {
    spheres.radii = array_of(*std::get<0>(radii));
    // Arrays of no spheres have no address, which would mean one radius for all.
    static const double none = 0;
    if (spheres.radii.data == nullptr) spheres.radii.data = &none;
  }
  spheres.radius = std::get<1>(radii);
  return spheres;
}

nb::object share_real(const ArrayView& view, bool is_double) {
  return is_double ? share<double>(view) : share<float>(view);
}

struct Call {
  SphereArrays spheres;
  std::optional<SphereArrays> others;
  SearchOptions options;

  const SphereArrays* others_or_null() const { return others ? &*others : nullptr; }
  bool is_double() const { return spheres.positions.is_double; }
};

using Three = std::array<double, 3>;
using Options = std::tuple<double, bool, std::array<std::string, 3>, Three, Three, std::int64_t, std::uintptr_t>;

Call call_of(const Described& positions, const Radii& radii, const std::optional<Described>& other_positions,
             const Radii& other_radii, const Options& given) {
  Call call;
  call.spheres = spheres_of(positions, radii);
  if (other_positions) call.others = spheres_of(*other_positions, other_radii);
  SearchOptions& options = call.options;
  const auto& [margin, is_inclusive, boundary, lower, upper, most_contacts, stream] = given;
  options.margin = margin;
  options.is_inclusive = is_inclusive;
  for (int axis = 0; axis < 3; ++axis) options.boundary[axis] = boundary_of(boundary[axis], axis);
  options.lower = lower;
  options.upper = upper;
  options.most_contacts = most_contacts;
  options.cuda_stream = reinterpret_cast<void*>(stream);
  return call;
}

}  // namespace

void bind_contacts(nb::module_& m) {
  using Other = std::optional<Described>;
  nb::class_<ContactFinder>(m, "ContactFinder")
      .def(nb::init<int, double>(), "threads"_a, "skin"_a)
      .def_prop_ro("reuses", &ContactFinder::reuses)
      .def("use_generic_form", &ContactFinder::use_generic_form, "is_generic"_a)
      .def("count",
           [](ContactFinder& finder, const Described& positions, const Radii& radii, const Other& others,
              const Radii& other_radii, const Options& options) {
             const Call call = call_of(positions, radii, others, other_radii, options);
             return without_gil([&] { return finder.count(call.spheres, call.options, call.others_or_null()); });
           })
      .def("counts",
           [](ContactFinder& finder, const Described& positions, const Radii& radii, const Other& others,
              const Radii& other_radii, const Options& options) {
             const Call call = call_of(positions, radii, others, other_radii, options);
             return share<std::int64_t>(
                 without_gil([&] { return finder.counts(call.spheres, call.options, call.others_or_null()); }));
           })
      .def("pairs",
           [](ContactFinder& finder, const Described& positions, const Radii& radii, const Other& others,
              const Radii& other_radii, const Options& options) {
             const Call call = call_of(positions, radii, others, other_radii, options);
             const ContactList found =
                 without_gil([&] { return finder.pairs(call.spheres, call.options, call.others_or_null()); });
             return nb::make_tuple(share<std::int32_t>(found.first), share<std::int32_t>(found.second));
           })
      .def("contacts",
           [](ContactFinder& finder, const Described& positions, const Radii& radii, const Other& others,
              const Radii& other_radii, const Options& options) {
             const Call call = call_of(positions, radii, others, other_radii, options);
             const ContactList found =
                 without_gil([&] { return finder.contacts(call.spheres, call.options, call.others_or_null()); });
             return nb::make_tuple(share<std::int32_t>(found.first), share<std::int32_t>(found.second),
                                   share_real(found.gap, call.is_double()), share_real(found.normal, call.is_double()));
           })
      .def("neighbors", [](ContactFinder& finder, const Described& positions, const Radii& radii, const Other& others,
                           const Radii& other_radii, const Options& options, bool keep_distances, bool is_squared,
                           bool sort_by_distance, std::int64_t most_neighbors) {
        const Call call = call_of(positions, radii, others, other_radii, options);
        NeighborOptions list;
        list.keep_distances = keep_distances;
        list.is_squared = is_squared;
        list.sort_by_distance = sort_by_distance;
        list.most_neighbors = most_neighbors;
        const NeighborList found =
            without_gil([&] { return finder.neighbors(call.spheres, call.options, call.others_or_null(), list); });
        return nb::make_tuple(share<std::int64_t>(found.offsets), share<std::int32_t>(found.indices),
                              keep_distances ? share_real(found.distances, call.is_double()) : nb::none(),
                              found.shortened_rows);
      });
  // (holder, address, shape, strides in elements, DLPack type code, bits, CUDA device) of a GPU's array.
  m.def(
      "describe_dlpack",
      [](const nb::ndarray<nb::ro, nb::device::cuda>& array) {
        nb::list shape, strides;
        for (std::size_t axis = 0; axis < array.ndim(); ++axis) {
          shape.append(array.shape(axis));
          strides.append(array.stride(axis));
        }
        auto* held = new nb::ndarray<nb::ro, nb::device::cuda>(array);
        const nb::capsule holder(
            held, [](void* p) noexcept { delete static_cast<nb::ndarray<nb::ro, nb::device::cuda>*>(p); });
        return nb::make_tuple(holder, reinterpret_cast<std::uintptr_t>(array.data()), shape, strides,
                              static_cast<int>(array.dtype().code), static_cast<int>(array.dtype().bits),
                              array.device_id());
      },
      "array"_a);
  m.def("cuda_device_of", &cuda_device_of, "address"_a);
}

}  // namespace fastcollide::python
