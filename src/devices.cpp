// Which devices there are, and which one a name means.
#include <fstream>

#include "backend/thread_pool.hpp"
#include "build_info.hpp"
#include "device_choice.hpp"
#include "engine.hpp"

#if defined(_WIN32)
#define NOMINMAX
#include <windows.h>
#elif defined(__linux__) || defined(__APPLE__)
#include <unistd.h>
#endif

namespace fastcollide {
namespace {

std::int64_t host_memory_bytes() {
#if defined(_WIN32)
  MEMORYSTATUSEX status{};
  status.dwLength = sizeof status;
  return GlobalMemoryStatusEx(&status) ? static_cast<std::int64_t>(status.ullTotalPhys) : 0;
#elif defined(__linux__) || defined(__APPLE__)
  return static_cast<std::int64_t>(sysconf(_SC_PHYS_PAGES)) * sysconf(_SC_PAGESIZE);
#else
  return 0;
#endif
}

std::string processor_name() {
  std::ifstream information("/proc/cpuinfo");  // elsewhere the file is absent and the name stays general
  for (std::string line; std::getline(information, line);) {
    const std::size_t colon = line.find(": ");
    if (line.rfind("model name", 0) == 0 && colon != std::string::npos) return line.substr(colon + 2);
  }
  return "CPU";
}

std::string names_of(const std::vector<Device>& found) {
  std::string names;
  for (const Device& device : found) names += (names.empty() ? "\"" : ", \"") + device.name + "\"";
  return names;
}

}  // namespace

std::string cpu_description(int threads) {
  return processor_name() + " (" + std::to_string(threads) + (threads == 1 ? " thread)" : " threads)");
}

std::vector<Device> devices() {
  std::vector<Device> found{{"cpu", cpu_description(hardware_threads()), host_memory_bytes()}};
  for (Device& device : cuda_devices()) found.push_back(std::move(device));
  return found;
}

int choose_device(const std::string& name) {
  if (name == "cpu") return cpu_device;
  const std::vector<Device> found = devices();
  if (name == "auto") return found.size() > 1 ? 0 : cpu_device;
  if (name == "cuda" && found.size() > 1) return 0;
  for (std::size_t i = 1; i < found.size(); ++i) {
    if (found[i].name == name) return static_cast<int>(i) - 1;
  }
  const bool is_cuda = name == "cuda" || (name.rfind("cuda:", 0) == 0 && name.size() > 5 &&
                                          name.find_first_not_of("0123456789", 5) == std::string::npos);
  if (!is_cuda) throw InvalidValue("device", -1, "\"" + name + "\"", "\"auto\", \"cpu\", \"cuda\" or \"cuda:N\"");
  throw DeviceError("device \"" + name + "\" is not there: " +
                    (build_info().cuda.empty() ? "this build has no CUDA; " : "") + "found " + names_of(found));
}

int choose_threads(int threads) {
  constexpr int most_threads = 1024;
  if (threads < 0 || threads > most_threads) {
    throw InvalidValue("threads", -1, std::to_string(threads), "1 to 1024, or 0 for all");
  }
  return threads == 0 ? std::min(hardware_threads(), most_threads) : threads;
}

#ifdef NDEBUG
constexpr bool is_debug = false;
#else
constexpr bool is_debug = true;
#endif

BuildInfo build_info() { return {build::version, build::compiler, build::cuda, build::cuda_architectures, is_debug}; }

Limits limits() {
  // Bodies and their crowding, the sorted grid with its unsorted keys, the sort's second pair of buffers.
  constexpr std::int64_t body = 2 * sizeof(Vec3) + 4 * sizeof(float);
  constexpr std::int64_t slot = 4 * sizeof(std::uint32_t) + 2 * sizeof(Vec4) + sizeof(float);
  constexpr std::int64_t sort = 2 * sizeof(std::uint32_t);
  // What the solver keeps from stage to stage.
  constexpr std::int64_t solver = sizeof(Vec3) + sizeof(std::uint32_t);
  // By cells, the copy of positions and velocities that a failed frame goes back to.
  constexpr std::int64_t kept = 2 * sizeof(Vec3) + sizeof(float);
  // By lists, see FrameRuns: two copies of the slots, where lists were made, lists with a chunk for each 16th sphere,
  // and room for twice as many strays as spheres. Records of who is near are left out, as worlds do without where
  // memory has no room for them.
  constexpr std::int64_t copies = 2 * (2 * sizeof(Vec4) + sizeof(float) + sizeof(MassId));
  constexpr std::int64_t start = sizeof(Vec4) + sizeof(std::uint32_t);
  constexpr std::int64_t list =
      (2 + FrameLists::rows_of_many + FrameLists::chunk_places / 16) * sizeof(std::uint32_t) + 4 * sizeof(StrayRecord);
  // And three copies of what contacts remember, without rolling resistance, with a place in a table for every sphere.
  constexpr std::int64_t in_table = sizeof(MemoryWord) + sizeof(std::uint64_t);
  constexpr std::int64_t remembered = sizeof(MemoryRow) + places_in_row * sizeof(MemoryWord) + in_table;
  constexpr std::int64_t spin = 2 * sizeof(Vec3) + sizeof(float) + 2 * sizeof(Spin) + 3 * remembered;
  constexpr std::int64_t common = body + slot + sort + solver;
  return {most_spheres, common + copies + start + list, common + kept, spin, 5 * sizeof(std::uint32_t), 1 << 17};
}

void copy_to_host(void* host, const void* device, std::size_t bytes, int cuda_device) {
  cuda_copy_to_host(host, device, bytes, cuda_device);
}

int cuda_device_of(std::uintptr_t address) { return device_of_cuda_memory(reinterpret_cast<const void*>(address)); }

void reset_after_fork() { forget_threads_after_fork(); }

}  // namespace fastcollide
