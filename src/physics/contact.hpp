// What one contact of the reference solver does to one of its two spheres.
#pragma once

#include "mass.hpp"
#include "overlap.hpp"

namespace fastcollide {

struct Sphere {
  Vec3 position;      // [m]
  float radius;       // [m]
  Vec3 velocity;      // [m/s]
  float restitution;  // 0 ... 1
  float mass;         // [kg]; infinite: fixed
  std::uint32_t id;
};

struct PairGeometry {
  ContactGeometry contact;
  float normal_velocity;  // < 0: approaching [m/s]
};

FC_HOST_DEVICE inline PairGeometry pair_geometry(const Sphere& a, const Sphere& b, Vec3 period) {
  const ContactGeometry contact = contact_geometry(a.position, a.radius, a.id, b.position, b.radius, b.id, period);
  return {contact, dot(a.velocity - b.velocity, contact.normal)};
}

struct ContactChange {
  Vec3 position;  // [m]
  Vec3 velocity;  // [m/s]
};

// The more dissipative of two materials decides.
FC_HOST_DEVICE inline float pair_restitution(float a, float b) { return smaller(a, b); }

// Change of sphere a by its contact with sphere b. Both are moved apart until they touch, each by the share that leaves
// their centre of mass at rest; if they approach, the impulse j = (1 + e) v_n m_a m_b / (m_a + m_b) along the normal
// reverses their normal velocity.
FC_HOST_DEVICE inline ContactChange resolve_contact(const Sphere& a, const Sphere& b, Vec3 period) {
  const ContactGeometry contact = contact_geometry(a.position, a.radius, a.id, b.position, b.radius, b.id, period);
  const float share = mass_share(a.mass, b.mass);
  const float approach = -dot(a.velocity - b.velocity, contact.normal);
  const float bounce = approach > 0.0f ? (1.0f + pair_restitution(a.restitution, b.restitution)) * approach : 0.0f;
  return {contact.normal * (larger(contact.depth, 0.0f) * share), contact.normal * (bounce * share)};
}

}  // namespace fastcollide
