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
  // Where that row and the first row of the next layer begin, in cells of the level.
  Numbers row_start, next_layer_start;
  // How many rows there are in the first layer beyond the first, and in the next one: a kind of sphere.
  std::array<std::uint8_t, size> kind;
};

constexpr int kinds = 6, other_kind = kinds;  // 0 or 1 row beyond the first, and 0, 1 or 2 in the next layer; all others

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

// For `count` spheres from the n-th on, in a level whose axes do not go round. In its own level a sphere begins with its
// own row: those before hold earlier slots alone.
template <class T>
FC_TARGET void find_rows(const SlotSearch<T>& input, const Level<T>& level, bool is_own, std::int64_t n, int count,
                         Block<T>& block) {
  const T *x = input.searchers.x + n, *y = x + input.searchers.stride, *z = y + input.searchers.stride;
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
    block.row_start[i] = row * first_y[i] + layer * first_z[i];
    block.next_layer_start[i] = row * block.y_first[i] + layer * (first_z[i] + 1);
    const bool is_other = (all_rows > 2) | (more_layers > 1);
    block.kind[i] = static_cast<std::uint8_t>(is_other ? other_kind : 3 * more_rows + more_layers * all_rows);
  }
}

struct Rest {
  std::uint32_t query, begin, end, unused;
};

// Compares a query with a whole run.
template <class T, bool has_radii, bool has_images>
FC_TARGET void search_run(const SlotSearch<T>& input, const typename Lanes<T>::Query& query, std::uint32_t begin,
                          std::uint32_t end, HitBuffer& hits) {
  for (std::uint32_t slot = begin; slot < end; slot += Lanes<T>::width) {
    hits.make_room(Lanes<T>::width);
    const std::uint32_t left = end - slot;
    const std::uint32_t live = left < Lanes<T>::width ? left : Lanes<T>::width;
    const unsigned found = Lanes<T>::template compare<has_radii, has_images>(input, query, slot, (1u << live) - 1u);
    hits.count += Lanes<T>::store(input, query, slot, found, hits.pairs + hits.count);
  }
}

// Spheres of one kind: of each run as many slots as there are lanes, without a branch that is hard to predict. What is
// longer goes to `rests`.
template <class T, bool has_radii, bool is_own, int more_rows, int next_rows>
FC_TARGET Rest* search_kind(const SlotSearch<T>& input, const Level<T>& level, const Block<T>& block, std::int64_t n,
                          const std::uint8_t* members, int count, HitBuffer& hits, Rest* rests) {
  const std::uint32_t* cell_start = input.cell_start + level.first_cell;
  const std::int64_t row = level.x.cells;
  std::uint32_t* pairs = hits.pairs + hits.count;
  for (int m = 0; m < count; ++m) {
    const int i = members[m];
    const auto q = static_cast<std::uint32_t>(n + i);
    const auto query = Lanes<T>::template query<has_radii>(input, q);
    const std::uint32_t* rows = cell_start + block.row_start[i];
    const std::uint32_t* next_rows_of = cell_start + block.next_layer_start[i];
    const int first = block.x_first[i], end_cell = block.x_last[i] + 1;
#pragma GCC unroll 4
    for (int r = 0; r < 1 + more_rows + next_rows; ++r) {
      const std::uint32_t* cells = r <= more_rows ? rows + r * row : next_rows_of + (r - 1 - more_rows) * row;
      const std::uint32_t begin = is_own && r == 0 ? q + 1 : cells[first], end = cells[end_cell];
      const std::uint32_t length = end - begin;
      const std::uint32_t live = length < Lanes<T>::width ? length : Lanes<T>::width;
      const unsigned found = Lanes<T>::template compare<has_radii, false>(input, query, begin, (1u << live) - 1u);
      pairs += Lanes<T>::store(input, query, begin, found, pairs);
      *rests = {q, begin + Lanes<T>::width, end, 0};
      rests += length > Lanes<T>::width ? 1 : 0;
    }
  }
  hits.count = pairs - hits.pairs;
  return rests;
}

template <class T, bool has_radii, bool is_own>
FC_TARGET void search_block(const SlotSearch<T>& input, const Level<T>& level, std::int64_t n, int count,
                            Block<T>& block, HitBuffer& hits) {
  std::uint8_t members[kinds + 1][Block<T>::size];
  int member_count[kinds + 1] = {};
  for (int i = 0; i < count; ++i) {
    const int kind = block.kind[i];
    members[kind][member_count[kind]++] = static_cast<std::uint8_t>(i);
  }
  constexpr int most_runs = 4 * Block<T>::size;
  hits.make_room(most_runs * Lanes<T>::width);
  Rest rests[most_runs + 1];
  Rest* rests_end = rests;
#define FC_KIND(more, next)                                                                                       \
  rests_end = search_kind<T, has_radii, is_own, more, next>(input, level, block, n, members[3 * (more) + (next)], \
                                                             member_count[3 * (more) + (next)], hits, rests_end)
  FC_KIND(0, 0);
  FC_KIND(0, 1);
  FC_KIND(0, 2);
  FC_KIND(1, 0);
  FC_KIND(1, 1);
  FC_KIND(1, 2);
#undef FC_KIND
  for (const Rest* rest = rests; rest < rests_end; ++rest) {
    const auto query = Lanes<T>::template query<has_radii>(input, rest->query);
    search_run<T, has_radii, false>(input, query, rest->begin, rest->end, hits);
  }
  for (int m = 0; m < member_count[other_kind]; ++m) {
    const int i = members[other_kind][m];
    const auto q = static_cast<std::uint32_t>(n + i);
    const auto query = Lanes<T>::template query<has_radii>(input, q);
    int y = is_own ? block.first_y[i] : block.y_first[i], z = is_own ? block.first_z[i] : block.z_first[i];
    for (; z <= block.z_last[i]; ++z, y = block.y_first[i]) {
      for (; y <= block.y_last[i]; ++y) {
        const std::uint32_t* cells = input.cell_start + level.first_cell +
                                     static_cast<std::int64_t>(level.x.cells) * (y + static_cast<std::int64_t>(level.y.cells) * z);
        const std::uint32_t begin = cells[block.x_first[i]];
        search_run<T, has_radii, false>(input, query, is_own && begin <= q ? q + 1 : begin, cells[block.x_last[i] + 1],
                                        hits);
      }
    }
  }
}

template <class T, bool has_radii>
FC_TARGET void search_level(const SlotSearch<T>& input, int k, bool is_own, std::int64_t n, int count, Block<T>& block,
                            HitBuffer& hits) {
  const SearchGrid<T>& grid = input.grid;
  const Level<T>& level = grid.levels[k];
  const Slots<T>& from = input.searchers;
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
    auto query = Lanes<T>::template query<has_radii>(input, q);
    auto visit = [&](std::uint32_t begin, std::uint32_t end, int image) {
      Lanes<T>::set_image(input, query, image);
      search_run<T, has_radii, true>(input, query, is_own && begin <= q ? q + 1 : begin, end, hits);
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
      if (input.targets.has_radii) {
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
