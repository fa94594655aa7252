// Words that are in the order of their rows, and in no order within each.
#pragma once

#include <cstdint>

#include "slot_search.hpp"

namespace fastcollide::search {

// So many words past the end are written.
inline constexpr std::int64_t sort_padding = 8;

// Sorts them, given the length of the longest row.
void sort_within_rows(std::uint32_t* words, std::int64_t count, std::int64_t longest, Simd simd);
void sort_within_rows(std::uint64_t* words, std::int64_t count, std::int64_t longest, Simd simd);

}  // namespace fastcollide::search
