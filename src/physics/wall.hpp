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

// Calls visit(normal, depth, is_floor) for each wall; the normal points inwards, depth is how far the sphere reaches
// in.
template <class Visit>
FC_HOST_DEVICE inline void visit_walls(Vec3 position, float radius, const Box& box, Visit& visit) {
  if (box.x == Boundary::wall) {
    visit(Vec3{1, 0, 0}, box.lower.x + radius - position.x, false);
    visit(Vec3{-1, 0, 0}, position.x - (box.upper.x - radius), false);
  }
  if (box.y == Boundary::wall) {
    visit(Vec3{0, 1, 0}, box.lower.y + radius - position.y, false);
    visit(Vec3{0, -1, 0}, position.y - (box.upper.y - radius), false);
  }
  if (box.z == Boundary::wall) {
    visit(Vec3{0, 0, 1}, box.lower.z + radius - position.z, true);
    visit(Vec3{0, 0, -1}, position.z - (box.upper.z - radius), false);
  }
}

}  // namespace fastcollide
