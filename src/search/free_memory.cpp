#include "free_memory.hpp"

#include <algorithm>
#include <fstream>
#include <limits>
#include <string>

#if defined(_WIN32)
#define NOMINMAX
#include <windows.h>
#endif

namespace fastcollide::search {
namespace {

constexpr std::int64_t very_many = std::numeric_limits<std::int64_t>::max() / 2;

#if !defined(_WIN32)
// The number after a word at the start of a line, or alone in the file for an empty word; `missing` where there is
// none.
std::int64_t number_in(const char* file, const std::string& word, std::int64_t missing) {
  std::ifstream in(file);
  for (std::string name; in >> name;) {
    std::int64_t number = missing;
    if (word.empty())
      return std::all_of(name.begin(), name.end(), [](char c) { return c >= '0' && c <= '9'; }) ? std::stoll(name)
                                                                                                : missing;
    if (name == word && in >> number) return number;
  }
  return missing;
}
#endif

}  // namespace

std::int64_t free_host_memory() {
#if defined(_WIN32)
  MEMORYSTATUSEX status{};
  status.dwLength = sizeof status;
  return GlobalMemoryStatusEx(&status) ? static_cast<std::int64_t>(status.ullAvailPhys) : very_many;
#else
  const std::int64_t kibibytes = number_in("/proc/meminfo", "MemAvailable:", very_many / 1024);
  // A container has less than its machine.
  const std::int64_t limit = number_in("/sys/fs/cgroup/memory.max", "", very_many);
  const std::int64_t used = number_in("/sys/fs/cgroup/memory.current", "", 0);
  return std::max<std::int64_t>(0, std::min(kibibytes * 1024, limit - used));
#endif
}

}  // namespace fastcollide::search
