// The loops of slot_search.cpp, which includes this file once for each instruction set, each time in a namespace of its
// own that has Lanes<T>: how some slots that lie side by side are compared with one sphere. FC_TARGET is the attribute
// that lets a function use these instructions.

// Windows of some spheres in one level, in loops that compilers turn into vector instructions, and the rows in them.
template <class T>
struct Block {
  static constexpr int size = 64;
  using Numbers = std::array<int, size>;

  std::array<T, size> reach;
  Numbers x_first, x_last, y_first, y_last, z_first, z_last;
  Numbers first_y, first_z;  // the row to begin with
  // Cells of the level: the first and the one past the last of the window in that row, and in the first row of the next
  // layer.
  Numbers run_first, run_end, next_first, next_end;
  // How many rows there are in the first layer beyond the first, and in the next one: a kind of sphere.
  std::array<std::uint8_t, size> kind;
};

constexpr int kinds = 6,
              other_kind = kinds;  // 0 or 1 row beyond the first, and 0, 1 or 2 in the next layer; all others

template <class T>
FC_TARGET void find_windows(const CellAxis<T>& axis, const T* places, const T* reach, int count, int* first,
                            int* last) {
  for (int i = 0; i < count; ++i) {
    const T pad = padded(places[i], reach[i]);
    first[i] = clamped_cell(places[i] - pad, axis);
    last[i] = clamped_cell(places[i] + pad, axis);
  }
}

template <class T>
FC_TARGET void find_cells(const CellAxis<T>& axis, const T* places, int count, int* cells) {
  for (int i = 0; i < count; ++i) cells[i] = clamped_cell(places[i], axis);
}

// For `count` spheres from the n-th on, in a level whose axes do not go round. In its own level a sphere begins with
// its own row: those before hold earlier slots alone.
template <class T>
FC_TARGET void find_rows(const SlotSearch<T>& input, const Level<T>& level, bool is_own, std::int64_t n, int count,
                         Block<T>& block) {
  const T *x = input.sets.searchers.x + n, *y = x + input.sets.searchers.stride, *z = y + input.sets.searchers.stride;
  find_windows(level.x, x, block.reach.data(), count, block.x_first.data(), block.x_last.data());
  find_windows(level.y, y, block.reach.data(), count, block.y_first.data(), block.y_last.data());
  find_windows(level.z, z, block.reach.data(), count, block.z_first.data(), block.z_last.data());
  const int* first_y = block.y_first.data();
  const int* first_z = block.z_first.data();
  if (is_own) {
    find_cells(level.y, y, count, block.first_y.data());
    find_cells(level.z, z, count, block.first_z.data());
    first_y = block.first_y.data();
    first_z = block.first_z.data();
  }
  const int row = level.x.cells, layer = level.x.cells * level.y.cells;
  for (int i = 0; i < count; ++i) {
    const int more_rows = block.y_last[i] - first_y[i], all_rows = block.y_last[i] - block.y_first[i] + 1;
    const int more_layers = block.z_last[i] - first_z[i];
    const int row_start = row * first_y[i] + layer * first_z[i];
    const int next_start = row * block.y_first[i] + layer * (first_z[i] + 1);
    block.run_first[i] = row_start + block.x_first[i];
    block.run_end[i] = row_start + block.x_last[i] + 1;
    block.next_first[i] = next_start + block.x_first[i];
    block.next_end[i] = next_start + block.x_last[i] + 1;
    const bool is_other = (all_rows > 2) | (more_layers > 1);
    block.kind[i] = static_cast<std::uint8_t>(is_other ? other_kind : 3 * more_rows + more_layers * all_rows);
  }
}

// Compares a query with a whole run.
template <class T, bool has_radii, bool has_images>
FC_TARGET void search_run(const Compared<T>& sets, const typename Lanes<T>::Query& query, std::uint32_t begin,
                          std::uint32_t end, HitBuffer& hits) {
  for (std::uint32_t slot = begin; slot < end; slot += Lanes<T>::width) {
    hits.make_room(Lanes<T>::width);
    const std::uint32_t left = end - slot;
    const std::uint32_t live = left < Lanes<T>::width ? left : Lanes<T>::width;
    const unsigned found = Lanes<T>::template compare<has_radii, has_images>(sets, query, slot, (1u << live) - 1u);
    hits.count += Lanes<T>::store(sets, query, slot, found, hits.pairs + hits.count);
  }
}

// The slots of the r-th run of a sphere of some kind. Always inline, also since GCC before 14 may take its instances
// for one function (its bug 113907).
template <class T, bool is_own, int more_rows>
[[gnu::always_inline]] FC_TARGET inline std::pair<std::uint32_t, std::uint32_t> run_of(const Block<T>& block,
                                                                                       const std::uint32_t* cell_start,
                                                                                       std::int64_t row, int i,
                                                                                       std::uint32_t q, int r) {
  if (r > more_rows) {
    const std::int64_t down = (r - 1 - more_rows) * row;
    return {cell_start[down + block.next_first[i]], cell_start[down + block.next_end[i]]};
  }
  return {is_own && r == 0 ? q + 1 : cell_start[r * row + block.run_first[i]], cell_start[r * row + block.run_end[i]]};
}

// Spheres of one kind: of each run as many slots as there are lanes, without a branch that is hard to predict; then the
// rest of those that are longer.
template <class T, bool has_radii, bool is_own, int more_rows, int next_rows>
FC_TARGET void search_kind(const SlotSearch<T>& input, const Level<T>& level, const Block<T>& block, std::int64_t n,
                           const std::uint8_t* members, int count, HitBuffer& hits) {
  constexpr std::uint32_t width = Lanes<T>::width;
  constexpr int runs = 1 + more_rows + next_rows;
  const Compared<T> sets = input.sets;  // of this function alone: what is written cannot change it
  const std::uint32_t* cell_start = input.cell_start + level.first_cell;
  const std::int64_t row = level.x.cells;
  hits.make_room(runs * width * count);
  std::uint32_t* pairs = hits.pairs + hits.count;
  std::uint8_t long_runs[Block<T>::size] = {};  // of each member, a bit for each run with more slots than lanes
  for (int m = 0; m < count; ++m) {
    const int i = members[m];
    const auto q = static_cast<std::uint32_t>(n + i);
    const auto query = Lanes<T>::template query<has_radii>(sets, q);
    unsigned are_long = 0;
#pragma GCC unroll 4
    for (int r = 0; r < runs; ++r) {
      const auto [begin, end] = run_of<T, is_own, more_rows>(block, cell_start, row, i, q, r);
      const std::uint32_t length = end - begin;
      const std::uint32_t live = length < width ? length : width;
      const unsigned found = Lanes<T>::template compare<has_radii, false>(sets, query, begin, (1u << live) - 1u);
      pairs += Lanes<T>::store(sets, query, begin, found, pairs);
      are_long |= (length > width ? 1u : 0u) << r;
    }
    long_runs[m] = static_cast<std::uint8_t>(are_long);
  }
  hits.count = pairs - hits.pairs;
  for (int m = 0; m < count; m += 8) {
    std::uint64_t marks;
    std::memcpy(&marks, long_runs + m, sizeof marks);
    for (; marks != 0; marks &= marks - 1) {
      const int bit = std::countr_zero(marks), i = members[m + bit / 8], r = bit % 8;
      const auto q = static_cast<std::uint32_t>(n + i);
      const auto [begin, end] = run_of<T, is_own, more_rows>(block, cell_start, row, i, q, r);
      const auto query = Lanes<T>::template query<has_radii>(sets, q);
      search_run<T, has_radii, false>(sets, query, begin + width, end, hits);
    }
  }
}

template <class T, bool has_radii, bool is_own>
FC_TARGET void search_block(const SlotSearch<T>& input, const Level<T>& level, std::int64_t n, int count,
                            Block<T>& block, HitBuffer& hits) {
  std::uint8_t members[kinds + 1][Block<T>::size];
  std::uint64_t counts = 0;  // of each kind, in a byte
  for (int i = 0; i < count; ++i) {
    const int byte = 8 * block.kind[i];
    members[block.kind[i]][counts >> byte & 0xFF] = static_cast<std::uint8_t>(i);
    counts += std::uint64_t(1) << byte;
  }
  const auto count_of = [counts](int kind) { return static_cast<int>(counts >> 8 * kind & 0xFF); };
#define FC_KIND(more, next)                                                                           \
  search_kind<T, has_radii, is_own, more, next>(input, level, block, n, members[3 * (more) + (next)], \
                                                count_of(3 * (more) + (next)), hits)
  FC_KIND(0, 0);
  FC_KIND(0, 1);
  FC_KIND(0, 2);
  FC_KIND(1, 0);
  FC_KIND(1, 1);
  FC_KIND(1, 2);
#undef FC_KIND
  for (int m = 0; m < count_of(other_kind); ++m) {
    const int i = members[other_kind][m];
    const auto q = static_cast<std::uint32_t>(n + i);
    const auto query = Lanes<T>::template query<has_radii>(input.sets, q);
    int y = is_own ? block.first_y[i] : block.y_first[i], z = is_own ? block.first_z[i] : block.z_first[i];
    for (; z <= block.z_last[i]; ++z, y = block.y_first[i]) {
      for (; y <= block.y_last[i]; ++y) {
        const std::uint32_t* cells =
            input.cell_start + level.first_cell +
            static_cast<std::int64_t>(level.x.cells) * (y + static_cast<std::int64_t>(level.y.cells) * z);
        const std::uint32_t begin = cells[block.x_first[i]];
        search_run<T, has_radii, false>(input.sets, query, is_own && begin <= q ? q + 1 : begin,
                                        cells[block.x_last[i] + 1], hits);
      }
    }
  }
}

template <class T, bool has_radii>
FC_TARGET void search_level(const SlotSearch<T>& input, int k, bool is_own, std::int64_t n, int count, Block<T>& block,
                            HitBuffer& hits) {
  const SearchGrid<T>& grid = input.grid;
  const Level<T>& level = grid.levels[k];
  const Slots<T>& from = input.sets.searchers;
  const T half_margin = static_cast<T>(grid.half_margin);
  for (int i = 0; i < count; ++i) {
    block.reach[i] = reach_into(level, has_radii ? from.radius(n + i) : T(0), half_margin);
  }
  const bool goes_round = level.x.goes_round || level.y.goes_round || level.z.goes_round;
  if (!goes_round) {
    find_rows(input, level, is_own, n, count, block);
    if (is_own) {
      search_block<T, has_radii, true>(input, level, n, count, block, hits);
    } else {
      search_block<T, has_radii, false>(input, level, n, count, block, hits);
    }
  }
  const bool is_periodic = grid.period.is_any();
  if (!goes_round && !is_periodic) return;
  for (int i = 0; i < count; ++i) {
    const auto q = static_cast<std::uint32_t>(n + i);
    const Point<T> p = from.position(q);
    auto query = Lanes<T>::template query<has_radii>(input.sets, q);
    auto visit = [&](std::uint32_t begin, std::uint32_t end, int image) {
      Lanes<T>::set_image(input.sets, query, image);
      search_run<T, has_radii, true>(input.sets, query, is_own && begin <= q ? q + 1 : begin, end, hits);
    };
    if (is_periodic) {
      visit_images(grid, k, input.cell_start, p, block.reach[i], 0, goes_round, visit);
    } else {
      auto visit_run = [&](std::uint32_t begin, std::uint32_t end) { visit(begin, end, no_image); };
      visit_runs(level, input.cell_start, window_around(p.x, block.reach[i], level.x),
                 window_around(p.y, block.reach[i], level.y), window_around(p.z, block.reach[i], level.z), 0,
                 visit_run);
    }
  }
}

template <class T>
FC_TARGET void search(const SlotSearch<T>& input, std::int64_t begin, std::int64_t end, HitSink sink) {
  const SearchGrid<T>& grid = input.grid;
  HitBuffer hits(sink);
  Block<T> block;
  // The level of the spheres that search, and where it ends: levels come one after the other. Another set has none.
  int own = input.is_one_set ? -1 : grid.level_count;
  std::int64_t own_end = input.is_one_set ? 0 : end;
  for (std::int64_t n = begin; n < end;) {
    while (n >= own_end) {
      ++own;
      own_end = input.cell_start[own + 1 < grid.level_count ? grid.levels[own + 1].first_cell : grid.cell_count];
    }
    const int count = static_cast<int>(std::min<std::int64_t>(Block<T>::size, std::min(own_end, end) - n));
    for (int k = 0; k < grid.level_count && k <= own; ++k) {
      if (input.sets.targets.has_radii) {
        search_level<T, true>(input, k, k == own, n, count, block, hits);
      } else {
        search_level<T, false>(input, k, k == own, n, count, block, hits);
      }
    }
    n += count;
    if (hits.count > HitBuffer::worth_a_call) hits.flush();
  }
  hits.flush();
}
