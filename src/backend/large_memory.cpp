#include "large_memory.hpp"

#include <cstdint>
#include <cstdlib>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace fastcollide {

#if defined(__linux__)

void* allocate_large(std::size_t bytes) {
  constexpr std::size_t page = std::size_t(2) << 20;
  if (bytes > SIZE_MAX - page) return nullptr;
  void* memory = std::aligned_alloc(page, (bytes + page - 1) / page * page);
  // A wish: where the system has no such pages, it serves with others.
  if (memory != nullptr) madvise(memory, bytes, MADV_HUGEPAGE);
  return memory;
}

void release_large(void* memory) { std::free(memory); }

#else

void* allocate_large(std::size_t bytes) { return ::operator new(bytes, std::nothrow); }

void release_large(void* memory) { ::operator delete(memory); }

#endif

}  // namespace fastcollide
