// What this machine can compute on.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace fastcollide {

struct Device {
  std::string name;         // as World takes it: "cpu", "cuda:0"
  std::string description;  // the maker's name and what else tells it apart
  std::int64_t memory_bytes = 0;
};

std::vector<Device> devices();

struct BuildInfo {
  std::string version, compiler;
  std::string cuda;                // version of the toolkit, empty if built without
  std::string cuda_architectures;  // as given to the build
  bool is_debug;                   // with assertions: nothing to measure speed with
};

BuildInfo build_info();

struct Limits {
  std::int64_t spheres;  // in one world
  // Of the memory of its device, while a world of more than 2^17 spheres in flight steps in the way that it takes by
  // itself; where spheres are crowded, lists of neighbours get longer. With Method::cells.
  std::int64_t bytes_per_sphere, bytes_by_cells;
  std::int64_t bytes_for_spin;  // likewise, more, where there is friction or spin
  // Likewise; a grid has at most 4 cells a sphere, or 2^18 if that is more; those of a world whose sizes are far apart
  // 32 together.
  std::int64_t bytes_per_cell;
  std::int64_t reach_in_radii;  // coordinates up to this many smallest radii from 0 are always allowed
};

Limits limits();

// Copies from the memory of a CUDA device, after all work on it. Errors: DeviceError.
void copy_to_host(void* host, const void* device, std::size_t bytes, int cuda_device);

// The number of the CUDA device whose memory an address lies in. Errors: DeviceError where it is none.
int cuda_device_of(std::uintptr_t address);

// A forked child process has none of its parent's threads; call this first in the child.
void reset_after_fork();

}  // namespace fastcollide
