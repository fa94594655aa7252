// Free flight through one frame.
#pragma once

#include "../math.hpp"

namespace fastcollide {

struct Flight {
  float dt;            // [s]
  Vec3 velocity_gain;  // gravity * dt [m/s]
  Vec3 position_gain;  // gravity * dt² / 2 [m]
  float damping;       // exp(-drag * dt)
};

// exp(-x) for x >= 0 by its series, from additions and multiplications alone: a math library's exp may differ in the
// last bit from one system to the next, and with it every later frame.
inline double exp_of_negative(double x) {
  if (x > 700.0) return 0.0;
  const int halvings = static_cast<int>(x) + 1;  // |y| <= 1: what twenty terms leave out is below 2^-65
  const double y = -x / halvings;
  double term = 1.0, sum = 1.0;
  for (int k = 1; k <= 20; ++k) {
    term = term * y / k;
    sum += term;
  }
  double power = 1.0;
  for (int k = 0; k < halvings; ++k) power *= sum;
  return power;
}

inline Flight flight_for(double dt, Vec3 gravity, double drag) {
  const float step = static_cast<float>(dt);
  return {step, gravity * step, gravity * (0.5f * step * step), static_cast<float>(exp_of_negative(drag * dt))};
}

// Velocity Verlet under constant gravity, then the drag v <- v exp(-drag dt): positions are exact without drag and of
// first order in dt with it.
FC_HOST_DEVICE inline void fly(Vec3& position, Vec3& velocity, const Flight& flight) {
  position = position + velocity * flight.dt + flight.position_gain;
  velocity = (velocity + flight.velocity_gain) * flight.damping;
}

}  // namespace fastcollide
