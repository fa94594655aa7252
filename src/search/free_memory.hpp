#pragma once

#include <cstdint>

namespace fastcollide::search {

// Bytes of the host that this process may still take, as far as the system tells; without a word from it, very many.
std::int64_t free_host_memory();

}  // namespace fastcollide::search
