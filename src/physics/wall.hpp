// The six walls of the box.
#pragma once

#include "box.hpp"
#include "mass.hpp"

namespace fastcollide {

struct WallMaterial {
  float floor_restitution;  // of the lower z wall; the other five use the sphere's own
  float friction;           // Coulomb coefficient of all six
};

// Coulomb friction of an impact that changed the normal velocity by `impact`: takes at most friction * impact from the
// two tangential components, and never turns them round.
FC_HOST_DEVICE inline void rub(float& tangent_1, float& tangent_2, float impact, float friction) {
  const float speed = square_root(tangent_1 * tangent_1 + tangent_2 * tangent_2);
  const float loss = friction * impact;
  const float kept = speed > loss ? 1.0f - loss / speed : 0.0f;
  tangent_1 = tangent_1 * kept;
  tangent_2 = tangent_2 * kept;
}

FC_HOST_DEVICE inline void collide_axis(float& x, float lower, float upper, float radius, float& normal,
                                        float& tangent_1, float& tangent_2, float restitution_lower,
                                        float restitution_upper, float friction) {
  const float lowest = lower + radius, highest = upper - radius;
  float impact = 0.0f;
  if (x < lowest) {
    x = lowest;
    if (normal < 0.0f) {
      impact = -normal * (1.0f + restitution_lower);
      normal = -normal * restitution_lower;
    }
  } else if (x > highest) {
    x = highest;
    if (normal > 0.0f) {
      impact = normal * (1.0f + restitution_upper);
      normal = -normal * restitution_upper;
    }
  }
  if (impact > 0.0f && friction > 0.0f) rub(tangent_1, tangent_2, impact, friction);
}

// Puts a sphere that reaches into a wall back inside and reverses the velocity that carried it there.
FC_HOST_DEVICE inline void collide_with_walls(Vec3& position, Vec3& velocity, float radius, float restitution,
                                              const Box& box, const WallMaterial& wall) {
  if (box.x == Boundary::wall) {
    collide_axis(position.x, box.lower.x, box.upper.x, radius, velocity.x, velocity.y, velocity.z, restitution,
                 restitution, wall.friction);
  }
  if (box.y == Boundary::wall) {
    collide_axis(position.y, box.lower.y, box.upper.y, radius, velocity.y, velocity.z, velocity.x, restitution,
                 restitution, wall.friction);
  }
  if (box.z == Boundary::wall) {
    collide_axis(position.z, box.lower.z, box.upper.z, radius, velocity.z, velocity.x, velocity.y,
                 wall.floor_restitution, restitution, wall.friction);
  }
}

// Where a flight ends: walls keep a free sphere inside by a radius; a fixed one, which no force can stop, goes through.
FC_HOST_DEVICE inline Vec3 place_in_box(Vec3 position, float radius, float mass, const Box& box) {
  return is_fixed(mass) ? first_image(position, box) : keep_inside(position, radius, box);
}

// How far a sphere reaches into the nearest wall, negative where it is clear of all; the depths are those of
// visit_walls.
FC_HOST_DEVICE inline float deepest_in_walls(Vec3 position, float radius, const Box& box) {
  float deepest = -3e38f;
  const auto look_at = [&](float x, float lower, float upper, Boundary boundary) {
    if (boundary == Boundary::wall) deepest = larger(deepest, larger(lower + radius - x, x - (upper - radius)));
  };
  look_at(position.x, box.lower.x, box.upper.x, box.x);
  look_at(position.y, box.lower.y, box.upper.y, box.y);
  look_at(position.z, box.lower.z, box.upper.z, box.z);
  return deepest;
}

// Of the six in the order of visit_walls.
inline constexpr int floor_side = 4;

FC_HOST_DEVICE inline float wall_restitution(const WallMaterial& wall, int side, float own_restitution) {
  return side == floor_side ? wall.floor_restitution : own_restitution;
}

// Speed along the normal at which a sphere in free flight touches a wall [m/s]: v² - 2 a x is the same all the way.
// `pull`: gravity along the normal [m/s²]; `depth` is negative before the two touch.
FC_HOST_DEVICE inline float touching_speed(float depth, float normal_velocity, float pull) {
  return square_root(larger(normal_velocity * normal_velocity + 2.0f * pull * depth, 0.0f));
}

// Calls visit(normal, depth, side) for each wall; the normal points inwards, depth is how far the sphere reaches
// in. One loop and not six copies of what is visited: a GPU waits for code that it has not at hand.
template <class Visit>
FC_HOST_DEVICE inline void visit_walls(Vec3 position, float radius, const Box& box, Visit& visit) {
  FC_NO_UNROLL
  for (int side = 0; side < 6; ++side) {
    const int axis = side / 2;
    const bool is_upper = side % 2 == 1;
    const auto along = [axis](auto x, auto y, auto z) { return axis == 0 ? x : axis == 1 ? y : z; };
    if (along(box.x, box.y, box.z) != Boundary::wall) continue;
    const float x = along(position.x, position.y, position.z);
    const float depth = is_upper ? x - (along(box.upper.x, box.upper.y, box.upper.z) - radius)
                                 : along(box.lower.x, box.lower.y, box.lower.z) + radius - x;
    const float sign = is_upper ? -1.0f : 1.0f;
    const Vec3 normal{axis == 0 ? sign : 0.0f, axis == 1 ? sign : 0.0f, axis == 2 ? sign : 0.0f};
    visit(normal, depth, side);
  }
}

}  // namespace fastcollide
