// Memory of the engine as arrays for Python.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>

#include "fastcollide/array_view.hpp"
#include "fastcollide/boundary.hpp"

namespace fastcollide::python {

namespace nb = nanobind;

template <class T>
constexpr const char* type_string() {
  if constexpr (std::is_same_v<T, float>) return "<f4";
  if constexpr (std::is_same_v<T, double>) return "<f8";
  if constexpr (std::is_same_v<T, std::int32_t>) return "<i4";
  if constexpr (std::is_same_v<T, std::int64_t>) return "<i8";
}

// The array shares the memory and keeps it alive.
template <class T>
nb::object share(const ArrayView& view) {
  const std::size_t shape[2] = {static_cast<std::size_t>(view.rows), static_cast<std::size_t>(view.columns)};
  const std::size_t dimensions = view.columns == 0 ? 1 : 2;
  auto* held = new std::shared_ptr<void>(view.owner);
  const nb::capsule owner(held, [](void* p) noexcept { delete static_cast<std::shared_ptr<void>*>(p); });
  if (view.cuda_device < 0) {
    return nb::cast(nb::ndarray<nb::numpy, T>(view.data, dimensions, shape, owner));
  }
  const nb::object inner = nb::cast(nb::ndarray<nb::array_api, T>(
      view.data, dimensions, shape, owner, nullptr, nb::dtype<T>(), nb::device::cuda::value, view.cuda_device));
  return nb::module_::import_("fastcollide.device_array")
      .attr("DeviceArray")(inner, reinterpret_cast<std::uintptr_t>(view.data),
                           dimensions == 1 ? nb::make_tuple(view.rows) : nb::make_tuple(view.rows, view.columns),
                           type_string<T>(), view.cuda_device);
}

template <class Work>
auto without_gil(Work&& work) {
  const nb::gil_scoped_release release;
  return work();
}

Boundary boundary_of(const std::string& name, int axis);

void bind_contacts(nb::module_& m);

}  // namespace fastcollide::python
