// Python's view of the C++ API: converts and checks, nothing more.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <chrono>
#include <optional>

#include "fastcollide/devices.hpp"
#include "fastcollide/renderer.hpp"
#include "fastcollide/world.hpp"
#include "format_frame.hpp"
#include "share.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using fastcollide::python::boundary_of;
using fastcollide::python::share;
using fastcollide::python::without_gil;
using Floats = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Ids = nb::ndarray<const std::uint32_t, nb::c_contig, nb::device::cpu>;
using Bytes = nb::ndarray<const std::uint8_t, nb::c_contig, nb::device::cpu>;

// Errors are Python classes, so that they carry attributes and pickle.
void raise(const char* name, const nb::object& arguments) {
  const nb::object type = nb::module_::import_("fastcollide.errors").attr(name);
  PyErr_SetObject(type.ptr(), arguments.ptr());
}

void translate(const std::exception_ptr& error, void*) {
  try {
    std::rethrow_exception(error);
  } catch (const fastcollide::InvalidValue& e) {
    const nb::object index = e.index() < 0 ? nb::none() : nb::cast(e.index());
    raise("InvalidValue", nb::make_tuple(e.what(), e.field(), index));
  } catch (const fastcollide::DeviceError& e) {
    raise("DeviceError", nb::make_tuple(e.what()));
  } catch (const fastcollide::SimulationError& e) {
    raise("SimulationError", nb::make_tuple(e.what()));
  } catch (const fastcollide::OutOfMemory& e) {
    raise("OutOfMemory", nb::make_tuple(e.what()));
  }
}

template <class Number>
nb::object own(std::vector<Number>&& values, std::size_t columns) {
  auto* held = new std::vector<Number>(std::move(values));
  const nb::capsule owner(held, [](void* p) noexcept { delete static_cast<std::vector<Number>*>(p); });
  const std::size_t shape[2] = {held->size() / std::max<std::size_t>(columns, 1), columns};
  return nb::cast(nb::ndarray<nb::numpy, Number>(held->data(), columns == 0 ? 1 : 2, shape, owner));
}

std::vector<float> copy_of(const Floats& array) { return {array.data(), array.data() + array.size()}; }
std::vector<std::uint32_t> copy_of(const Ids& array) { return {array.data(), array.data() + array.size()}; }

// Asks Python for signals a few times a second, so that Ctrl-C ends a run between two frames.
class SignalCheck {
 public:
  bool operator()() {
    const auto now = std::chrono::steady_clock::now();
    if (now < next_) return true;
    next_ = now + std::chrono::milliseconds(50);
    const nb::gil_scoped_acquire gil;
    raised_ = PyErr_CheckSignals() != 0;
    if (raised_) error_.emplace();  // takes the exception out of the interpreter until the run has ended
    return !raised_;
  }
  void rethrow() {
    if (raised_) throw std::move(*error_);
  }

 private:
  std::chrono::steady_clock::time_point next_ = std::chrono::steady_clock::now();
  std::optional<nb::python_error> error_;
  bool raised_ = false;
};

fastcollide::Method method_of(const std::string& name) {
  if (name == "auto") return fastcollide::Method::automatic;
  if (name == "cells") return fastcollide::Method::cells;
  if (name == "list") return fastcollide::Method::list;
  if (name == "frame") return fastcollide::Method::frame;
  if (name == "levels") return fastcollide::Method::levels;
  if (name == "small") return fastcollide::Method::small;
  throw fastcollide::InvalidValue("method", -1, '"' + name + '"',
                                  R"("auto", "cells", "list", "frame", "levels" or "small")");
}

// A call that waits for its turn while it holds the interpreter would stop the one that is stepping: all let go of it.
void bind_world(nb::module_& m) {
  using fastcollide::World;
  using Three = std::array<float, 3>;
  nb::class_<World>(m, "World")
      .def(
          "__init__",
          [](World* self, const Three& lower, const Three& upper, const std::array<std::string, 3>& boundary,
             const Three& gravity, double drag, float floor_restitution, float wall_friction, float rolling_friction,
             bool is_reference, int iterations, float cell_size, const std::string& device, int threads,
             const std::string& method, int block_size) {
            fastcollide::WorldOptions options;
            options.lower = lower;
            options.upper = upper;
            for (int axis = 0; axis < 3; ++axis) options.boundary[axis] = boundary_of(boundary[axis], axis);
            options.gravity = gravity;
            options.drag = drag;
            options.floor_restitution = floor_restitution;
            options.wall_friction = wall_friction;
            options.rolling_friction = rolling_friction;
            options.solver = is_reference ? fastcollide::Solver::reference : fastcollide::Solver::substep;
            options.iterations = iterations;
            options.cell_size = cell_size;
            options.device = device;
            options.threads = threads;
            options.method = method_of(method);
            options.block_size = block_size;
            new (self) World(options);
          },
          nb::kw_only(), "lower"_a, "upper"_a, "boundary"_a, "gravity"_a, "drag"_a, "floor_restitution"_a,
          "wall_friction"_a, "rolling_friction"_a, "is_reference"_a, "iterations"_a, "cell_size"_a, "device"_a,
          "threads"_a, "method"_a, "block_size"_a)
      .def(
          "add",
          [](World& world, const Floats& position, const Floats& velocity, const Floats& radius, const Floats& mass,
             const Floats& restitution, const std::optional<Floats>& spin, const std::optional<Floats>& friction) {
            fastcollide::Spheres spheres{
                copy_of(position), copy_of(velocity), copy_of(radius), copy_of(mass), copy_of(restitution), {}, {}};
            if (spin) spheres.spin = copy_of(*spin);
            if (friction) spheres.friction = copy_of(*friction);
            return without_gil([&] { return world.add(spheres); });
          },
          "position"_a, "velocity"_a, "radius"_a, "mass"_a, "restitution"_a, "spin"_a.none() = nb::none(),
          "friction"_a.none() = nb::none())
      .def(
          "step",
          [](World& world, std::int64_t frames, double dt) {
            SignalCheck check;
            without_gil([&] { return world.step(frames, dt, [&check] { return check(); }); });
            check.rethrow();
          },
          "frames"_a, "dt"_a)
      .def("save",
           [](World& world) {
             fastcollide::WorldState state = without_gil([&] { return world.save(); });
             nb::dict saved;
             const auto put = [&saved](const char* name, auto& values, std::size_t columns) {
               saved[name] = own(std::move(values), columns);
             };
             put("position", state.spheres.position, 3);
             put("velocity", state.spheres.velocity, 3);
             put("radius", state.spheres.radius, 0);
             put("mass", state.spheres.mass, 0);
             put("restitution", state.spheres.restitution, 0);
             if (!state.spheres.spin.empty()) put("spin", state.spheres.spin, 3);
             if (!state.spheres.friction.empty()) put("friction", state.spheres.friction, 0);
             if (!state.crowding.empty()) put("crowding", state.crowding, 0);
             if (!state.contacts.owner.empty()) {
               put("contact_owner", state.contacts.owner, 0);
               put("contact_partner", state.contacts.partner, 0);
               put("contact_slide", state.contacts.slide, 3);
               if (!state.contacts.roll.empty()) put("contact_roll", state.contacts.roll, 3);
             }
             saved["frame"] = state.frame;
             saved["start_frame"] = state.start_frame;
             saved["start_time"] = state.start_time;
             saved["dt"] = state.dt;
             saved["fast_spheres"] = state.fast_spheres;
             saved["fastest_flight"] = state.fastest_flight;
             saved["fastest_dt"] = state.fastest_dt;
             return saved;
           })
      .def(
          "restore",
          [](World& world, const Floats& position, const Floats& velocity, const Floats& radius, const Floats& mass,
             const Floats& restitution, std::int64_t frame, std::int64_t start_frame, double start_time, double dt,
             std::int64_t fast_spheres, double fastest_flight, double fastest_dt, const std::optional<Floats>& spin,
             const std::optional<Floats>& friction, const std::optional<Floats>& crowding,
             const std::optional<Ids>& contact_owner, const std::optional<Ids>& contact_partner,
             const std::optional<Floats>& contact_slide, const std::optional<Floats>& contact_roll) {
            fastcollide::WorldState state;
            state.spheres = {
                copy_of(position), copy_of(velocity), copy_of(radius), copy_of(mass), copy_of(restitution), {}, {}};
            if (spin) state.spheres.spin = copy_of(*spin);
            if (friction) state.spheres.friction = copy_of(*friction);
            if (crowding) state.crowding = copy_of(*crowding);
            if (contact_owner) state.contacts.owner = copy_of(*contact_owner);
            if (contact_partner) state.contacts.partner = copy_of(*contact_partner);
            if (contact_slide) state.contacts.slide = copy_of(*contact_slide);
            if (contact_roll) state.contacts.roll = copy_of(*contact_roll);
            state.frame = frame;
            state.start_frame = start_frame;
            state.start_time = start_time;
            state.dt = dt;
            state.fast_spheres = fast_spheres;
            state.fastest_flight = fastest_flight;
            state.fastest_dt = fastest_dt;
            without_gil([&] { world.restore(state); });
          },
          nb::kw_only(), "position"_a, "velocity"_a, "radius"_a, "mass"_a, "restitution"_a, "frame"_a, "start_frame"_a,
          "start_time"_a, "dt"_a, "fast_spheres"_a, "fastest_flight"_a, "fastest_dt"_a, "spin"_a.none() = nb::none(),
          "friction"_a.none() = nb::none(), "crowding"_a.none() = nb::none(), "contact_owner"_a.none() = nb::none(),
          "contact_partner"_a.none() = nb::none(), "contact_slide"_a.none() = nb::none(),
          "contact_roll"_a.none() = nb::none())
      .def("set_gravity", &World::set_gravity, nb::call_guard<nb::gil_scoped_release>())
      .def("set_drag", &World::set_drag, nb::call_guard<nb::gil_scoped_release>())
      .def("set_floor_restitution", &World::set_floor_restitution, nb::call_guard<nb::gil_scoped_release>())
      .def("set_wall_friction", &World::set_wall_friction, nb::call_guard<nb::gil_scoped_release>())
      .def("set_restitution", &World::set_restitution, nb::call_guard<nb::gil_scoped_release>())
      .def("set_friction", &World::set_friction, nb::call_guard<nb::gil_scoped_release>())
      .def_prop_ro("count", [](const World& world) { return without_gil([&] { return world.count(); }); })
      .def_prop_ro("frame", [](const World& world) { return without_gil([&] { return world.frame(); }); })
      .def_prop_ro("time", [](const World& world) { return without_gil([&] { return world.time(); }); })
      .def_prop_ro("device", [](const World& world) { return world.device(); })
      .def_prop_ro("device_name", &World::device_description)
      .def_prop_ro("has_spin", [](const World& world) { return without_gil([&] { return world.has_spin(); }); })
      .def_prop_ro("positions",
                   [](World& world) { return share<float>(without_gil([&] { return world.positions(); })); })
      .def_prop_ro("velocities",
                   [](World& world) { return share<float>(without_gil([&] { return world.velocities(); })); })
      .def_prop_ro("radii", [](World& world) { return share<float>(without_gil([&] { return world.radii(); })); })
      .def_prop_ro("masses", [](World& world) { return share<float>(without_gil([&] { return world.masses(); })); })
      .def_prop_ro("restitutions",
                   [](World& world) { return share<float>(without_gil([&] { return world.restitutions(); })); })
      .def_prop_ro("spins", [](World& world) { return share<float>(without_gil([&] { return world.spins(); })); })
      .def_prop_ro("frictions",
                   [](World& world) { return share<float>(without_gil([&] { return world.frictions(); })); })
      .def("contacts",
           [](World& world) {
             const fastcollide::ContactArrays found = without_gil([&] { return world.contacts(); });
             return nb::make_tuple(share<std::int32_t>(found.first), share<std::int32_t>(found.second),
                                   share<float>(found.gap), share<float>(found.normal));
           })
      .def("contact_count", &World::contact_count, nb::call_guard<nb::gil_scoped_release>())
      .def("energy",
           [](World& world) {
             const fastcollide::Energy energy = without_gil([&] { return world.energy(); });
             return nb::make_tuple(energy.kinetic, energy.rotational, energy.potential);
           })
      .def("momentum", &World::momentum, nb::call_guard<nb::gil_scoped_release>())
      .def("angular_momentum", &World::angular_momentum, nb::call_guard<nb::gil_scoped_release>())
      .def("max_overlap", &World::max_overlap, nb::call_guard<nb::gil_scoped_release>())
      .def("mean_overlap", &World::mean_overlap, nb::call_guard<nb::gil_scoped_release>())
      .def("measure",
           [](World& world) {
             const fastcollide::Measurements all = without_gil([&] { return world.measure(); });
             return nb::make_tuple(nb::make_tuple(all.energy.kinetic, all.energy.rotational, all.energy.potential),
                                   all.momentum, all.angular_momentum, all.contact_count, all.max_overlap,
                                   all.mean_overlap);
           })
      .def("state_hash", &World::state_hash, nb::call_guard<nb::gil_scoped_release>())
      .def_prop_ro("fast_flights",
                   [](const World& world) {
                     const fastcollide::FastFlights flights = without_gil([&] { return world.fast_flights(); });
                     return nb::make_tuple(flights.fast_spheres, flights.safe_iterations, flights.safe_dt);
                   })
      .def("set_timed", &World::set_timed, "timed"_a, nb::call_guard<nb::gil_scoped_release>())
      .def_prop_ro("stage_times", [](const World& world) { return without_gil([&] { return world.stage_times(); }); });
}

void bind_renderer(nb::module_& m) {
  using fastcollide::Renderer;
  using Three = std::array<float, 3>;
  nb::class_<Renderer>(m, "Renderer")
      .def(nb::init<const std::string&, int>(), "device"_a = "auto", "threads"_a = 0)
      .def(
          "draw",
          [](Renderer& renderer, int width, int height, int supersampling, const Three& eye, const Three& target,
             const Three& up, float tan_half_field, const Three& lower, const Three& upper, const Bytes& color_table,
             float low, float high, const nb::ndarray<const float, nb::c_contig>& positions,
             const nb::ndarray<const float, nb::c_contig>& radii,
             const nb::ndarray<const float, nb::c_contig>& values) {
            const bool on_cuda = positions.device_type() == nb::device::cuda::value;
            for (const auto* array : {&radii, &values}) {
              if (array->size() * 3 != positions.size() || array->device_type() != positions.device_type()) {
                throw nb::value_error("positions (n, 3), radii (n,) and values (n,) must agree in n and device");
              }
            }
            fastcollide::Picture picture;
            if (color_table.size() != picture.color_table.size()) throw nb::value_error("color_table must be (256, 3)");
            picture.width = width;
            picture.height = height;
            picture.supersampling = supersampling;
            picture.eye = eye;
            picture.target = target;
            picture.up = up;
            picture.tan_half_field = tan_half_field;
            picture.box_lower = lower;
            picture.box_upper = upper;
            std::copy_n(color_table.data(), color_table.size(), picture.color_table.begin());
            picture.value_low = low;
            picture.value_high = high;
            const std::size_t pixels = std::size_t(std::max(width, 0)) * std::size_t(std::max(height, 0));
            auto* rgb = new std::vector<std::uint8_t>(3 * pixels);
            const nb::capsule owner(rgb, [](void* p) noexcept { delete static_cast<std::vector<std::uint8_t>*>(p); });
            without_gil([&] {
              renderer.draw(picture, static_cast<std::int64_t>(radii.size()), positions.data(), radii.data(),
                            values.data(), on_cuda ? positions.device_id() : -1, rgb->data());
            });
            const std::size_t shape[3] = {std::size_t(height), std::size_t(width), 3};
            return nb::cast(nb::ndarray<nb::numpy, std::uint8_t>(rgb->data(), 3, shape, owner));
          },
          "width"_a, "height"_a, "supersampling"_a, "eye"_a, "target"_a, "up"_a, "tan_half_field"_a, "lower"_a,
          "upper"_a, "color_table"_a, "low"_a, "high"_a, "positions"_a, "radii"_a, "values"_a);
}

void bind_random(nb::module_& m) {
  using Two = std::array<float, 2>;
  using Three = std::array<float, 3>;
  m.def(
      "random_spheres",
      [](std::int64_t count, const Three& lower, const Three& upper, std::uint64_t seed, const Two& radius,
         const Three& speed, const Two& restitution, float density, const std::string& device) {
        fastcollide::RandomSpheres random;
        random.count = count;
        random.lower = lower;
        random.upper = upper;
        random.seed = seed;
        random.radius = radius;
        random.speed = speed;
        random.restitution = restitution;
        random.density = density;
        fastcollide::Spheres spheres = without_gil([&] { return fastcollide::random_spheres(random, device); });
        return nb::make_tuple(own(std::move(spheres.position), 3), own(std::move(spheres.velocity), 3),
                              own(std::move(spheres.radius), 0), own(std::move(spheres.mass), 0),
                              own(std::move(spheres.restitution), 0));
      },
      "count"_a, "lower"_a, "upper"_a, "seed"_a, "radius"_a, "speed"_a, "restitution"_a, "density"_a, "device"_a);
}

void bind_machine(nb::module_& m) {
  m.def("limits", [] {
    const fastcollide::Limits limits = fastcollide::limits();
    return nb::make_tuple(limits.spheres, limits.bytes_per_sphere, limits.bytes_by_cells, limits.bytes_for_spin,
                          limits.bytes_per_cell, limits.reach_in_radii);
  });
  m.def("devices", [] {
    nb::list found;
    for (const fastcollide::Device& device : fastcollide::devices()) {
      found.append(nb::make_tuple(device.name, device.description, device.memory_bytes));
    }
    return found;
  });
  m.def("build_info", [] {
    const fastcollide::BuildInfo info = fastcollide::build_info();
    return nb::make_tuple(info.version, info.compiler, info.cuda, info.cuda_architectures, info.is_debug);
  });
  m.def(
      "copy_to_host",
      [](const nb::ndarray<nb::c_contig, nb::device::cuda>& array) {
        auto* bytes = new std::vector<std::uint8_t>(array.nbytes());
        const nb::capsule owner(bytes, [](void* p) noexcept { delete static_cast<std::vector<std::uint8_t>*>(p); });
        without_gil([&] { fastcollide::copy_to_host(bytes->data(), array.data(), bytes->size(), array.device_id()); });
        std::vector<std::size_t> shape(array.ndim());
        for (std::size_t axis = 0; axis < shape.size(); ++axis) shape[axis] = array.shape(axis);
        return nb::cast(
            nb::ndarray<nb::numpy>(bytes->data(), shape.size(), shape.data(), owner, nullptr, array.dtype()));
      },
      "array"_a);
  m.def("reset_after_fork", &fastcollide::reset_after_fork);
  m.def(
      "format_frame",
      [](std::int64_t frame, double time, const Floats& positions, const Floats& radii) {
        if (positions.size() != 3 * radii.size())
          throw nb::value_error("positions (n, 3) and radii (n,) must agree in n");
        const std::string text = without_gil([&] {
          return fastcollide::format_frame(frame, time, static_cast<std::int64_t>(radii.size()), positions.data(),
                                           radii.data());
        });
        return nb::bytes(text.data(), text.size());
      },
      "frame"_a, "time"_a, "positions"_a, "radii"_a);
}

}  // namespace

fastcollide::Boundary fastcollide::python::boundary_of(const std::string& name, int axis) {
  if (name == "wall") return Boundary::wall;
  if (name == "periodic") return Boundary::periodic;
  if (name == "open") return Boundary::open;
  throw InvalidValue("boundary", axis, '"' + name + '"', "\"wall\", \"periodic\" or \"open\"");
}

NB_MODULE(_core, m) {
  m.doc() = "The engine of FastCollide. Use the package fastcollide; the names here may change.";
  nb::register_exception_translator(translate);
  bind_world(m);
  bind_renderer(m);
  bind_random(m);
  bind_machine(m);
  fastcollide::python::bind_contacts(m);
}
