#include "validation.hpp"

#include <cmath>

#include "grid_shape.hpp"
#include "stages/check_state.hpp"
#include "text.hpp"

namespace fastcollide {
namespace {

void check_box(const std::array<float, 3>& lower, const std::array<float, 3>& upper,
               const std::array<Boundary, 3>& boundary = {}) {
  for (int axis = 0; axis < 3; ++axis) {
    if (boundary[axis] == Boundary::open) continue;
    const auto require_corner = [axis](bool good, const char* corner, float found, const std::string& allowed) {
      if (!good) throw InvalidValue("bounds", axis, std::string(corner) + " corner " + text_of(found), allowed);
    };
    require_corner(std::isfinite(lower[axis]), "lower", lower[axis], "finite numbers [m]");
    require_corner(std::isfinite(upper[axis]), "upper", upper[axis], "finite numbers [m]");
    require_corner(upper[axis] > lower[axis], "upper", upper[axis],
                   "more than the lower corner, " + text_of(lower[axis]) + " m");
    require_corner(upper[axis] - lower[axis] <= 1e18f, "upper", upper[axis], "sides of at most 1e18 m");
  }
}

void check_lengths(const Spheres& spheres) {
  const std::size_t count = spheres.radius.size();
  const auto check = [count](const char* field, std::size_t found, std::size_t columns) {
    if (found == count * columns) return;
    throw InvalidValue(field, -1, std::to_string(found) + " numbers",
                       std::to_string(count * columns) + ", for " + std::to_string(count) + " radii");
  };
  check("position", spheres.position.size(), 3);
  check("velocity", spheres.velocity.size(), 3);
  check("mass", spheres.mass.size(), 1);
  check("restitution", spheres.restitution.size(), 1);
  if (!spheres.spin.empty()) check("spin", spheres.spin.size(), 3);
  if (!spheres.friction.empty()) check("friction", spheres.friction.size(), 1);
}

const float* value_of(const Spheres& spheres, Field field, std::int64_t i) {
  switch (field) {
    case Field::position:
      return spheres.position.data() + 3 * i;
    case Field::velocity:
      return spheres.velocity.data() + 3 * i;
    case Field::radius:
      return spheres.radius.data() + i;
    case Field::mass:
      return spheres.mass.data() + i;
    case Field::spin:
      return spheres.spin.data() + 3 * i;
    case Field::friction:
      return spheres.friction.data() + i;
    case Field::restitution:
      break;
  }
  return spheres.restitution.data() + i;
}

// As every run checks them: spheres that have moved need not be inside the bounds.
void check_numbers(const Spheres& spheres, const Box& box) {
  check_lengths(spheres);
  const RadiusRange radii = allowed_radii(box);
  const CheckBody body{box,
                       radii.smallest,
                       radii.largest,
                       reinterpret_cast<const Vec3*>(spheres.position.data()),
                       reinterpret_cast<const Vec3*>(spheres.velocity.data()),
                       spheres.radius.data(),
                       spheres.mass.data(),
                       spheres.restitution.data(),
                       spheres.spin.empty() ? nullptr : reinterpret_cast<const Vec3*>(spheres.spin.data()),
                       spheres.friction.empty() ? nullptr : spheres.friction.data()};
  for (std::int64_t i = 0; i < static_cast<std::int64_t>(spheres.radius.size()); ++i) {
    const StateCheck check = body(i);
    const Field field = Field(check.first_bad % 8);
    if (check.first_bad != no_fault) refuse_value(box, field, i, value_of(spheres, field, i));
  }
}

}  // namespace

void require(bool good, const char* field, double found, const std::string& allowed, std::int64_t index) {
  if (!good) throw InvalidValue(field, index, text_of(found), allowed);
}

void check_options(const WorldOptions& options) {
  check_box(options.lower, options.upper, options.boundary);
  for (int axis = 0; axis < 3; ++axis) {
    require(std::isfinite(options.gravity[axis]), "gravity", options.gravity[axis], "finite numbers [m/s²]", axis);
  }
  require(between(options.drag, 0, 1e6), "drag", options.drag, "0 to 1e6 [1/s]");
  require(between(options.floor_restitution, 0, 1), "floor_restitution", options.floor_restitution, "0 to 1");
  require(between(options.wall_friction, 0, 1e6), "wall_friction", options.wall_friction, "0 to 1e6");
  require(between(options.rolling_friction, 0, 1e6), "rolling_friction", options.rolling_friction, "0 to 1e6");
  require(options.rolling_friction == 0 || options.solver != Solver::reference, "rolling_friction",
          options.rolling_friction, "0: spheres of the reference solver do not turn");
  require(options.iterations >= 1 && options.iterations <= 1000, "iterations", options.iterations, "1 to 1000");
  require(between(options.cell_size, 0, 1e30), "cell_size", options.cell_size, "a finite number above 0 [m]");
  require(options.block_size >= 32 && options.block_size <= 512 && options.block_size % 32 == 0, "block_size",
          options.block_size, "a multiple of 32 from 32 to 512");
}

void check_count(std::int64_t spheres) {
  if (spheres > most_spheres) {
    throw InvalidValue("count", -1, std::to_string(spheres) + " spheres in one world", "at most 268435456");
  }
}

void check_spheres(const Spheres& spheres, const WorldOptions& options) {
  check_numbers(spheres, box_of(options));
  for (std::int64_t i = 0; i < static_cast<std::int64_t>(spheres.radius.size()); ++i) {
    if (options.solver == Solver::reference && !spheres.friction.empty() && spheres.friction[i] > 0) {
      throw InvalidValue("friction", i, text_of(spheres.friction[i]),
                         "0: the reference solver has no friction of spheres");
    }
    for (int axis = 0; axis < 3; ++axis) {
      const float x = spheres.position[static_cast<std::size_t>(3 * i + axis)];
      if (options.boundary[axis] != Boundary::open && !between(x, options.lower[axis], options.upper[axis])) {
        throw InvalidValue(
            "position", i, std::string(1, "xyz"[axis]) + " = " + text_of(x),
            text_of(options.lower[axis]) + " to " + text_of(options.upper[axis]) + " m, inside the bounds");
      }
    }
  }
}

void check_restitution(float restitution) { require(between(restitution, 0, 1), "restitution", restitution, "0 to 1"); }

void check_friction(float friction, const WorldOptions& options) {
  require(between(friction, 0, largest_friction), "friction", friction, "0 to 1e6");
  require(friction == 0 || options.solver != Solver::reference, "friction", friction,
          "0: the reference solver has no friction of spheres");
}

namespace {

// Sorted, so that no pair comes twice; numbers that can be squared.
void check_contact_state(const ContactState& contacts, std::int64_t count, bool is_kept, bool has_roll) {
  const auto known = static_cast<std::int64_t>(contacts.owner.size());
  const auto has = [known](const auto& values, std::int64_t columns) {
    return static_cast<std::int64_t>(values.size()) == known * columns;
  };
  require(known == 0 || is_kept, "contact_owner", static_cast<double>(known),
          "none: spheres without friction and spin remember no contacts");
  require(has(contacts.partner, 1), "contact_partner", static_cast<double>(contacts.partner.size()),
          "one for each contact_owner");
  require(has(contacts.slide, 3), "contact_slide", static_cast<double>(contacts.slide.size()),
          "three numbers for each contact_owner");
  require(has(contacts.roll, has_roll ? 3 : 0), "contact_roll", static_cast<double>(contacts.roll.size()),
          "three numbers for each contact_owner, none without rolling friction");
  std::uint64_t before = 0;
  for (std::int64_t i = 0; i < known; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const std::uint64_t owner = contacts.owner[at], partner = contacts.partner[at], pair = owner << 32 | partner;
    const bool is_sphere = partner < static_cast<std::uint64_t>(count) && partner != owner;
    const bool is_wall = partner >= ContactState::first_wall && partner < ContactState::first_wall + 6u;
    require(owner < static_cast<std::uint64_t>(count), "contact_owner", static_cast<double>(owner), "an id", i);
    require(is_sphere || is_wall, "contact_partner", static_cast<double>(partner), "the id of another sphere or a wall",
            i);
    require(i == 0 || pair > before, "contact_partner", static_cast<double>(partner),
            "contacts sorted by owner and partner, each once", i);
    before = pair;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      require(between(contacts.slide[3 * at + axis], -1e15, 1e15), "contact_slide", contacts.slide[3 * at + axis],
              "-1e15 to 1e15 [m]", i);
      if (has_roll) {
        require(between(contacts.roll[3 * at + axis], -1e15, 1e15), "contact_roll", contacts.roll[3 * at + axis],
                "-1e15 to 1e15 [rad]", i);
      }
    }
  }
}

}  // namespace

void check_world_state(const WorldState& state, const WorldOptions& options) {
  const auto count = static_cast<std::int64_t>(state.spheres.radius.size());
  check_count(count);
  check_numbers(state.spheres, box_of(options));
  const auto known = static_cast<std::int64_t>(state.crowding.size());
  require(known == 0 || (known == count && options.solver == Solver::substep), "crowding", static_cast<double>(known),
          "a number for each sphere of the default solver, or none");
  for (std::int64_t i = 0; i < known; ++i) {
    const float found = state.crowding[static_cast<std::size_t>(i)];
    require(std::isfinite(found), "crowding", found, "a finite number", i);
  }
  check_contact_state(state.contacts, count, !state.spheres.spin.empty() && options.solver == Solver::substep,
                      options.rolling_friction > 0.0f);
  require(state.frame >= 0, "frame", static_cast<double>(state.frame), "0 or more");
  require(state.start_frame >= 0 && state.start_frame <= state.frame, "start_frame",
          static_cast<double>(state.start_frame), "0 to the frame");
  require(state.start_time >= 0 && std::isfinite(state.start_time), "start_time", state.start_time,
          "a finite number from 0 [s]");
  require(state.dt == 0 || between(state.dt, 1e-9, 1e3), "dt", state.dt, "1e-9 to 1000 [s], or 0 before any frame");
  require(state.fast_spheres >= 0, "fast_spheres", static_cast<double>(state.fast_spheres), "0 or more");
  require(between(state.fastest_flight, 0, 1e18), "fastest_flight", state.fastest_flight, "0 to 1e18");
  require(between(state.fastest_dt, 1e-9, 1e3), "fastest_dt", state.fastest_dt, "1e-9 to 1000 [s]");
}

void check_random(const RandomSpheres& random) {
  check_box(random.lower, random.upper);
  require(random.count >= 0 && random.count <= most_spheres, "count", static_cast<double>(random.count),
          "0 to 268435456");
  require(random.radius[0] > 0 && std::isfinite(random.radius[0]), "radius", random.radius[0],
          "a finite number above 0 [m]", 0);
  require(random.radius[1] >= random.radius[0] && std::isfinite(random.radius[1]), "radius", random.radius[1],
          "a finite number not below the smallest radius [m]", 1);
  for (int axis = 0; axis < 3; ++axis) {
    require(2 * random.radius[1] <= random.upper[axis] - random.lower[axis], "radius", random.radius[1],
            "at most half of the shortest side of the bounds", 1);
    require(std::isfinite(random.speed[axis]) && random.speed[axis] >= 0, "speed", random.speed[axis],
            "a finite number not below 0 [m/s]", axis);
  }
  require(between(random.restitution[0], 0, 1), "restitution", random.restitution[0], "0 to 1", 0);
  require(between(random.restitution[1], random.restitution[0], 1), "restitution", random.restitution[1],
          "the lower limit to 1", 1);
  require(random.density > 0 && std::isfinite(random.density), "density", random.density,
          "a finite number above 0 [kg/m³]");
}

}  // namespace fastcollide
