// Is what the user gave in its range? Throws InvalidValue with field, index, what was found and what is allowed.
#pragma once

#include <string>

#include "fastcollide/world.hpp"

namespace fastcollide {

void require(bool good, const char* field, double found, const std::string& allowed, std::int64_t index = -1);

// False for NaN.
inline bool between(double x, double low, double high) { return x >= low && x <= high; }

void check_count(std::int64_t spheres);
void check_options(const WorldOptions& options);
void check_spheres(const Spheres& spheres, const WorldOptions& options);
// Of all spheres of a world.
void check_restitution(float restitution);
void check_friction(float friction, const WorldOptions& options);
void check_world_state(const WorldState& state, const WorldOptions& options);
void check_random(const RandomSpheres& random);

}  // namespace fastcollide
