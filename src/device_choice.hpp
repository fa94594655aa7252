#pragma once

#include <string>

#include "fastcollide/devices.hpp"

namespace fastcollide {

inline constexpr int cpu_device = -1;

// The number of the CUDA device that a name means, or cpu_device.
int choose_device(const std::string& name);

// Threads to use: all for 0.
int choose_threads(int threads);

std::string cpu_description(int threads);

}  // namespace fastcollide
