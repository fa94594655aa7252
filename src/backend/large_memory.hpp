// Memory for large arrays on the host, in pages of 2 MiB where the system has them: to walk through an array in no
// order then takes a few entries of the processor's address table in place of thousands, and its first use a page fault
// for each 2 MiB in place of 4 KiB.
#pragma once

#include <cstddef>

namespace fastcollide {

// Smaller arrays are no better off.
inline constexpr std::size_t large_memory = std::size_t(4) << 20;  // [bytes]

// nullptr if there is not as much.
void* allocate_large(std::size_t bytes);
void release_large(void* memory);

}  // namespace fastcollide
