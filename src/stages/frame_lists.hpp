// Lists of the spheres near each one, made anew after some frames and never mended.
//
// As in neighbor_lists.hpp, two spheres are listed when they are within reach of each other even if both move through
// the whole of their skins. A sphere that leaves its skin before the lists end is a stray: the pass that moves it
// writes it into a table of coarse cells, and the next pass looks there for strays that its lists do not know. A stray
// itself looks through the grid. So no pair is missed, none is seen twice, and nothing has to wait for a repair.
#pragma once

#include "neighbor_lists.hpp"

namespace fastcollide {

// What the device tells the host about a run of frames, and its stages tell each other.
struct FrameControl {
  std::uint32_t frame;             // counted from 0 in a run; the first with the lists that there are
  std::uint32_t next_frame;        // the first with the next lists
  std::uint32_t next_slot;         // that the next block of cells takes
  std::uint32_t next_chunk;        // that the next list too long for its rows takes
  std::uint32_t most_chunks;       // that a frame wanted
  std::uint32_t void_lists;        // too short, in all frames
  std::uint32_t longest;           // that a pass wanted, where it found more than a list and strays have room for
  std::uint32_t stray_records[3];  // in turn: of the pass before, of this one, of the next
  std::uint32_t most_stray_records;
  std::uint32_t next_helped;         // place among the strays that get help
  std::uint32_t near_records[2][2];  // in turn of this pass, of the next: with who is near, without
  Vec3 drift, next_drift;            // with which the skins move with these lists and with the next ones [m/s]
  // Of some spheres, for the lists that are made next.
  std::uint64_t velocity_sum[3];  // in units of 2^-20 m/s
  std::uint64_t speed_sum;        // beside the drift, likewise
  std::uint32_t fast;             // as Drift::fast: how many
  std::uint32_t touched;          // by others, in the substep before
  // And of the last lists that were made.
  std::uint32_t fast_samples, touched_samples;
  float mean_speed;  // [m/s]
  Watch watch;
};

// Keeps the mean velocity of some spheres for the skins of the next lists, how they move beside it and whether others
// touch them.
struct Drift {
  static constexpr float unit = 0x1p-20f, fastest = 1e6f;  // [m/s]
  std::uint32_t samples;
  std::uint32_t stride;  // from one of their slots to the next
  float fast;            // such a sphere leaves any skin that is kept long [m/s]

  // `crowding` of all slots, or null.
  FC_HOST_DEVICE void add(std::int64_t slot, Vec3 velocity, const float* crowding, FrameControl* control) const {
    if (slot % stride != 0 || slot / stride >= samples) return;
    const auto word = [](float speed) {
      return static_cast<std::uint64_t>(round_to_int64(clamp(speed, -fastest, fastest) * (1.0f / unit)));
    };
    atomic_add(&control->velocity_sum[0], word(velocity.x));
    atomic_add(&control->velocity_sum[1], word(velocity.y));
    atomic_add(&control->velocity_sum[2], word(velocity.z));
    const float speed = length(velocity - control->next_drift);
    atomic_add(&control->speed_sum, word(speed));
    if (!(speed < fast)) atomic_add(&control->fast, 1);
    if (crowding != nullptr && crowding[slot] != 0.0f) atomic_add(&control->touched, 1);
  }
  FC_HOST_DEVICE void end(FrameControl* control) const {
    const float part = unit / static_cast<float>(samples);
    const auto mean = [&](std::uint64_t& sum) {
      const float value = static_cast<float>(static_cast<std::int64_t>(sum)) * part;
      sum = 0;
      return value;
    };
    std::uint64_t* sums = control->velocity_sum;
    control->next_drift = {mean(sums[0]), mean(sums[1]), mean(sums[2])};
    control->mean_speed = mean(control->speed_sum);
    control->fast_samples = control->fast;
    control->touched_samples = control->touched;
    control->fast = control->touched = 0;
  }
};

// Entry k of a sphere belongs to lane k % lanes. Spheres whose entries are read at the same time lie side by side:
// `width` words hold one entry of each lane of width / lanes spheres. Where a sphere has one lane, a list too long for
// its rows goes on in a chunk of its own. A count may be larger than the places: then the list is void, and its sphere
// looks through the grid in each pass.
struct FrameLists {
  static constexpr std::uint32_t rows_of_many = 48, chunk_places = 96;
  static constexpr std::uint32_t fewest_rows = NearSearch::at_once;  // read at once, whatever the count is
  // In a count: the sphere has left its skin; others do the work on it.
  static constexpr std::uint32_t stray_bit = 0x80000000u, helped_bit = 0x40000000u;
  FC_HOST_DEVICE static std::uint32_t without_bits(std::uint32_t count) { return count & ~(stray_bit | helped_bit); }

  std::uint32_t* entries;
  std::uint32_t* counts;
  std::uint32_t rows;  // entries of one lane
  std::uint32_t lane_bits, width_bits;
  std::uint32_t* chunk_of_slot;  // 1 + its number; 0: none
  std::uint32_t* chunk_entries;
  std::uint32_t chunks;  // that there are

  FC_HOST_DEVICE std::uint32_t lanes() const { return 1u << lane_bits; }
  FC_HOST_DEVICE std::uint32_t places() const { return rows << lane_bits; }  // of a sphere without a chunk
  FC_HOST_DEVICE std::uint32_t places_of(std::int64_t slot, std::uint32_t count) const {
    if (chunks == 0 || count <= rows || chunk_of_slot[slot] == 0) return places();
    return rows + chunk_places;
  }
  // As chunk_of_slot.
  FC_HOST_DEVICE std::uint32_t take_chunk(FrameControl* control) const {
    const std::uint32_t chunk = atomic_add(&control->next_chunk, 1);
    if (chunk < chunks) return chunk + 1;
    atomic_max(&control->most_chunks, chunk + 1);
    return 0;
  }
  FC_HOST_DEVICE std::uint32_t* entries_of_chunk(std::uint32_t chunk) const {
    return chunk_entries + std::int64_t(chunk - 1) * chunk_places;
  }
  FC_HOST_DEVICE std::int64_t stride() const { return std::int64_t(1) << width_bits; }  // from row to row
  FC_HOST_DEVICE std::uint32_t* of_lane(std::int64_t slot, std::uint32_t lane) const {
    const std::uint32_t sphere_bits = width_bits - lane_bits;
    const std::int64_t block = slot >> sphere_bits, sphere = slot - (block << sphere_bits);
    return entries + ((block * rows) << width_bits) + (sphere << lane_bits) + lane;
  }
  FC_HOST_DEVICE std::uint32_t entry(std::int64_t slot, std::uint32_t k) const {
    return of_lane(slot, k & (lanes() - 1))[std::int64_t(k >> lane_bits) * stride()];
  }
};

// A stray is in the chain of each coarse cell from where it may be reached.
struct StrayRecord {
  std::uint32_t slot, next;
};

// Where all axes end in walls, a compiler that is told so leaves out what belongs to the other boundaries.
FC_HOST_DEVICE inline void assume_walls(GridShape& shape) {
  shape.x.boundary = shape.y.boundary = shape.z.boundary = Boundary::wall;
}
FC_HOST_DEVICE inline void assume_walls(Box& box) { box.x = box.y = box.z = Boundary::wall; }

// The strays that one pass of a frame writes and the next one reads.
struct Strays {
  GridShape coarse;
  std::uint64_t* heads;    // of each cell: the pass that wrote it, the last record
  std::uint32_t* regions;  // of each region of 4 x 4 x 4 cells: the last pass that wrote one of them
  StrayRecord* records;
  std::uint32_t places;
  // The first strays since the lists were made, each with the pass that wrote it: to look through the grid takes long,
  // so that on a GPU a warp does it for each of them, before the others begin.
  std::uint64_t* helped;
  std::uint32_t helped_places;
  std::uint32_t pass, passes;  // which of how many
  FrameControl* control;

  FC_HOST_DEVICE std::uint32_t stamp() const { return control->frame * passes + pass + 1; }

  FC_HOST_DEVICE void add(std::uint32_t slot, Vec3 position, float range) const {
    const std::uint64_t mark = std::uint64_t(stamp()) << 32;
    const CellRange xs = cells_within(position.x, range, coarse.x);
    const CellRange ys = cells_within(position.y, range, coarse.y);
    const CellRange zs = cells_within(position.z, range, coarse.z);
    const auto wanted = static_cast<std::uint32_t>(xs.count * ys.count * zs.count);
    const std::uint32_t first = atomic_add(&control->stray_records[pass % 3], wanted);
    if (first + wanted > places) {
      atomic_max(&control->most_stray_records, first + wanted);
      return;
    }
    // Four at a time, so that a GPU waits for them once.
    constexpr int at_once = 4;
    for (int begin = 0; begin < static_cast<int>(wanted); begin += at_once) {
      std::uint64_t before[at_once];
      FC_UNROLL
      for (int k = 0; k < at_once; ++k) {
        const int i = begin + k;
        if (i >= static_cast<int>(wanted)) continue;
        const Vec3i cell{cell_in_range(xs, i % xs.count, coarse.x),
                         cell_in_range(ys, i / xs.count % ys.count, coarse.y),
                         cell_in_range(zs, i / xs.count / ys.count, coarse.z)};
        before[k] = atomic_exchange(heads + cell_hash(cell, coarse), mark | (first + static_cast<unsigned>(i)));
        atomic_max(regions + region_of(cell), stamp());
      }
      FC_UNROLL
      for (int k = 0; k < at_once; ++k) {
        if (begin + k >= static_cast<int>(wanted)) continue;
        const bool is_first = (before[k] ^ mark) >> 32 != 0;
        records[first + static_cast<unsigned>(begin + k)] = {
            slot, is_first ? no_slot : static_cast<std::uint32_t>(before[k])};
      }
    }
  }

  // Of one that has just left its skin: whether it gets help from now on.
  FC_HOST_DEVICE bool ask_for_help(std::uint32_t slot) const {
    if (helped_places == 0) return false;
    const std::uint32_t place = atomic_add(&control->next_helped, 1);
    if (place >= helped_places) return false;
    helped[place] = std::uint64_t(stamp()) << 32 | slot;
    return true;
  }
  // The stray in a place, as passes before this one wrote it, or no_slot.
  FC_HOST_DEVICE std::uint32_t helped_in(std::uint32_t place) const {
    if (place >= helped_places) return no_slot;
    const std::uint64_t word = helped[place];
    const auto written = static_cast<std::uint32_t>(word >> 32);
    const bool has_these_lists = written > control->frame * passes && written <= stamp();
    return has_these_lists ? static_cast<std::uint32_t>(word) : no_slot;
  }

  // Most regions have none, and those of spheres that lie side by side in memory are few words.
  static constexpr int region_bits = 2;
  static std::int64_t region_count(const GridShape& coarse) {
    return std::int64_t(regions_along(coarse.x)) * regions_along(coarse.y) * regions_along(coarse.z);
  }
  FC_HOST_DEVICE static int regions_along(const GridAxis& axis) { return ((axis.cells - 1) >> region_bits) + 1; }
  FC_HOST_DEVICE std::uint32_t region_of(Vec3i cell) const {
    const int y = (cell.z >> region_bits) * regions_along(coarse.y) + (cell.y >> region_bits);
    return static_cast<std::uint32_t>(y * regions_along(coarse.x) + (cell.x >> region_bits));
  }
  FC_HOST_DEVICE std::uint32_t stamp_near(Vec3 position) const { return regions[region_of(cell_of(position, coarse))]; }
  // 0: none.
  FC_HOST_DEVICE std::uint64_t head_near(Vec3 position) const {
    const std::uint64_t head = heads[cell_hash(cell_of(position, coarse), coarse)];
    return static_cast<std::uint32_t>(head >> 32) == stamp() ? head : 0;
  }
  // Calls visit(slot) for those of a cell's chain.
  template <class Visit>
  FC_HOST_DEVICE void visit(std::uint64_t head, Visit& visit) const {
    for (auto place = static_cast<std::uint32_t>(head); place != no_slot; place = records[place].next) {
      visit(records[place].slot);
    }
  }
};

// A ball that holds a sphere as long as it stays in its skin: place, radius and skin. Two spheres are listed when the
// balls come within reach of each other; the same bits whichever of the two comes first.
FC_HOST_DEVICE inline bool are_listed(Vec4 a, Vec4 b, Vec3 period, float reach) {
  const Vec3 offset = separation({a.x, a.y, a.z}, {b.x, b.y, b.z}, period);
  const float range = (a.w + b.w) + reach;
  return dot(offset, offset) <= range * range;
}

// A fiftieth of the skin makes up for rounding: distances are right to a few 2^-24 and the skin is no thinner than a
// twentieth of the largest radius. Across a periodic end, differences have the rounding of the period.
FC_HOST_DEVICE inline bool is_out_of_skin(Vec4 ball, float radius, Vec3 position, Vec3 period) {
  const Vec3 moved = separation(position, {ball.x, ball.y, ball.z}, period);
  const float most = larger(0.98f * (ball.w - radius) - 1e-6f * (period.x + period.y + period.z), 0.0f);
  return !(dot(moved, moved) <= most * most);  // also where a coordinate is no number
}

// The slots as they were sorted, for those who search them later in the frame.
struct SortedSlots {
  GridShape shape;
  const std::uint32_t *cell_start, *cell_end;
  const Vec4* balls;
  SkinLaw law;

  // From where a ball stands to those that may be listed with it.
  FC_HOST_DEVICE float search_range(Vec4 ball) const { return ball.w + law.reach + law.largest_radius + law.thickest; }
};

// Calls visit_run(slot, end) for the slots in the cells that are no farther than `range` from a position; rows of cells
// are shared among the lanes. Cells count along x first: those of a row are one run, or two where the row goes round.
template <class VisitRun>
FC_HOST_DEVICE inline void visit_sorted_runs(const SortedSlots& sorted, Vec3 position, float range, Lane lane,
                                             const VisitRun& visit_run) {
  const GridShape& shape = sorted.shape;
  const CellRange ys = cells_within(position.y, range, shape.y), zs = cells_within(position.z, range, shape.z);
  const CellDistances y_distances(position.y, ys, shape.y), z_distances(position.z, zs, shape.z);
  const float most = 1.0001f * (range * range);
  int y = lane.index, z = 0;
  for (;;) {
    for (; y >= ys.count; y -= ys.count) ++z;
    if (z >= zs.count) return;
    // A row at a distance needs a shorter run: about half of the box around the position is outside of the sphere.
    const float left = most - y_distances.squared(y) - z_distances.squared(z);
    if (left >= 0.0f) {
      const CellRange xs = cells_within(position.x, rough_square_root(left), shape.x);
      const int inside = xs.first + xs.count <= shape.x.cells ? xs.count : shape.x.cells - xs.first;
      const std::uint32_t row = cell_hash({0, cell_in_range(ys, y, shape.y), cell_in_range(zs, z, shape.z)}, shape);
      const auto visit_cells = [&](int first, int cells) {
        const std::uint32_t end = sorted.cell_end[row + static_cast<std::uint32_t>(first + cells - 1)];
        visit_run(sorted.cell_start[row + static_cast<std::uint32_t>(first)], end);
      };
      visit_cells(xs.first, inside);
      if (shape.x.boundary != Boundary::wall && inside < xs.count) visit_cells(0, xs.count - inside);
    }
    y += lane.count;
  }
}

// Calls visit(slot, ball) for each of them.
template <std::uint32_t at_once = 1, class Visit>
FC_HOST_DEVICE inline void visit_sorted(const SortedSlots& sorted, Vec3 position, float range, Lane lane,
                                        Visit& visit) {
  const auto visit_run = [&](std::uint32_t slot, std::uint32_t end) {
    for (; slot < end; slot += at_once) {
      Vec4 balls[at_once];
      FC_UNROLL
      for (std::uint32_t k = 0; k < at_once; ++k) balls[k] = sorted.balls[slot + k < end ? slot + k : slot];
      FC_UNROLL
      for (std::uint32_t k = 0; k < at_once; ++k) {
        if (k == 0 || slot + k < end) visit(slot + k, balls[k]);
      }
    }
  };
  visit_sorted_runs(sorted, position, range, lane, visit_run);
}

// Entries that one of several lanes has found, until it asks for places in the list of its sphere: once for many.
struct FoundEntries {
  static constexpr std::uint32_t most = 12;
  std::uint32_t slots[most], count = 0;

  FC_HOST_DEVICE void move_to(const FrameLists& lists, std::uint32_t slot, FrameControl* control) {
    if (count == 0) return;
    const std::uint32_t first = atomic_add(&lists.counts[slot], count);
    for (std::uint32_t i = 0; i < count; ++i) {
      const std::uint32_t place = first + i, row = place >> lists.lane_bits;
      if (row < lists.rows) {
        lists.of_lane(slot, place & (lists.lanes() - 1))[std::int64_t(row) * lists.stride()] = slots[i];
      }
    }
    if (first <= lists.places() && first + count > lists.places()) atomic_add(&control->void_lists, 1);
    count = 0;
  }
};

// Makes the lists. `lanes` neighbours of the counter share a sphere, or one has it for itself.
template <bool is_shared>
struct RecordFrameLists {
  SortedSlots sorted;
  Vec3 period;
  const MassId* mass_ids;
  FrameLists lists;
  Drift drift;
  FrameControl* control;

  FC_HOST_DEVICE void assume_walls() {
    period = {0, 0, 0};
    fastcollide::assume_walls(sorted.shape);
  }
  FC_HOST_DEVICE void operator()(std::int64_t row) const {
    if (row == 0) drift.end(control);
    const auto slot = static_cast<std::uint32_t>(row >> (is_shared ? lists.lane_bits : 0));
    if (is_fixed(mass_ids[slot].mass)) return;  // nothing pushes it, so it asks for nobody
    const Vec4 self = sorted.balls[slot];
    const Vec3 position{self.x, self.y, self.z};
    const float range = sorted.search_range(self);
    if constexpr (is_shared) {
      FoundEntries found;
      auto record = [&](std::uint32_t other, Vec4 there) {
        if (!are_listed(self, there, period, sorted.law.reach) || other == slot) return;
        found.slots[found.count++] = other;
        if (found.count == FoundEntries::most) found.move_to(lists, slot, control);
      };
      const int lanes = static_cast<int>(lists.lanes());
      visit_sorted<2>(sorted, position, range, {static_cast<int>(row) & (lanes - 1), lanes}, record);
      found.move_to(lists, slot, control);
    } else {
      std::uint32_t* place = lists.of_lane(slot, 0);
      std::uint32_t found = 0, chunk = 0;
      const auto record_far = [&](std::uint32_t other) {  // where the rows end
        if (found < lists.rows) {
          *place = other;
          place += lists.stride();
        } else {
          if (found == lists.rows) chunk = lists.take_chunk(control);
          const std::uint32_t beyond = found - lists.rows;
          if (chunk > 0 && beyond < FrameLists::chunk_places) lists.entries_of_chunk(chunk)[beyond] = other;
        }
        ++found;
      };
      // Two at a time, so that they are asked for at once and whether there is room is, too.
      const auto record_run = [&](std::uint32_t first, std::uint32_t end) {
        for (; first < end; first += 2) {
          const std::uint32_t slots[2] = {first, first + 1 < end ? first + 1 : slot};
          const Vec4 balls[2] = {sorted.balls[slots[0]], sorted.balls[slots[1]]};
          const auto is_in_list = [&](int k) {
            return are_listed(self, balls[k], period, sorted.law.reach) && slots[k] != slot;
          };
          if (found + 2 <= lists.rows) {
            FC_UNROLL
            for (int k = 0; k < 2; ++k) {
              if (!is_in_list(k)) continue;
              *place = slots[k];
              place += lists.stride();
              ++found;
            }
          } else {
            for (int k = 0; k < 2; ++k) {
              if (is_in_list(k)) record_far(slots[k]);
            }
          }
        }
      };
      visit_sorted_runs(sorted, position, range, Lane{}, record_run);
      lists.counts[slot] = found;
      if (found <= lists.rows) return;
      lists.chunk_of_slot[slot] = chunk;
      if (found > lists.places_of(slot, found)) atomic_add(&control->void_lists, 1);
    }
  }
};

// Who is near a sphere in flight, where that is known. With 6 places it was not for many of those that land: 1,000,000
// of which a quarter were touched took 2.4 ms, with 14 places 1.42, without records 1.54.
struct alignas(32) NearRecord {
  static constexpr std::uint32_t places = 14;
  static constexpr std::uint32_t unknown = ~std::uint32_t(0);  // as count

  std::uint32_t slot, count, near[places];
};

// What a contact pass looks at: the list and, where the pass before has left strays, those that it does not know.
struct FrameListNeighbors {
  SortedSlots sorted;
  FrameLists lists;
  Strays strays;  // of the pass before
  bool is_first;  // there is none
  float age;      // of the lists [s]

  FC_HOST_DEVICE void assume_walls() {
    fastcollide::assume_walls(sorted.shape);
    fastcollide::assume_walls(strays.coarse);
  }

  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane, Visit& visit) const {
    // All that a GPU can ask for at once, before it knows how much of it counts.
    std::uint32_t* list = lists.of_lane(slot, static_cast<std::uint32_t>(lane.index));
    std::uint32_t first[FrameLists::fewest_rows];
    FC_UNROLL
    for (std::uint32_t k = 0; k < FrameLists::fewest_rows; ++k) first[k] = list[std::int64_t(k) * lists.stride()];
    const std::uint32_t stamp = is_first ? 0 : strays.stamp_near(position);
    const std::uint32_t count = lists.counts[slot];
    const std::uint32_t wanted = FrameLists::without_bits(count);
    const bool is_void = wanted > lists.places_of(slot, wanted);
    const std::uint32_t all = is_void ? 0 : wanted;
    // Entries of this lane, and the first row that no lane uses.
    const std::uint32_t own = (all + lists.lanes() - 1 - static_cast<std::uint32_t>(lane.index)) >> lists.lane_bits;
    const std::uint32_t rows = (all + lists.lanes() - 1) >> lists.lane_bits;
    std::uint32_t* chunk = nullptr;
    if (lane.count == 1 && all > lists.rows) chunk = lists.entries_of_chunk(lists.chunk_of_slot[slot]);
    std::uint32_t unlisted = 0;
    const bool is_stray = count != wanted, are_strays_near = !is_first && stamp == strays.stamp();
    if (is_stray || are_strays_near) {
      const std::uint64_t head = are_strays_near ? strays.head_near(position) : 0;
      if (is_stray || head != 0) {
        unlisted = write_unlisted(grid, slot, position, lane, list, chunk, rows, is_stray, head);
      }
    }
    const auto slot_at = [&](std::uint32_t i) {
      const std::uint32_t row = i < own ? i : i - own + rows;
      return lane.count == 1 && row >= lists.rows ? chunk[row - lists.rows] : list[std::int64_t(row) * lists.stride()];
    };
    // The first entries, of which some may not count, are in `first` already.
    Vec4 there[FrameLists::fewest_rows];
    FC_UNROLL
    for (std::uint32_t k = 0; k < FrameLists::fewest_rows; ++k) {
      there[k] = grid.position_radius[k < own ? first[k] : static_cast<std::uint32_t>(slot)];
    }
    const NearSearch search{grid.position_radius, grid.period, position,
                            grid.position_radius[slot].w + sorted.law.reach};
    const std::uint32_t looked_at = own < FrameLists::fewest_rows ? own : FrameLists::fewest_rows;
    search.visit(looked_at, search.near_of(there, 0, looked_at), own + unlisted, slot_at, visit);
    if (is_void) visit_grid(grid, slot, lane, visit);
  }

  // Writes who is near to near(0), near(1) and so on, and returns how many there are; unknown where they are too many
  // or not all in the list.
  template <class Near>
  FC_HOST_DEVICE std::uint32_t find_near(const GridView& grid, std::int64_t slot, Vec4 self, const Near& near) const {
    const Vec3 position{self.x, self.y, self.z};
    // As in visit(), asked for before the count is known.
    const std::uint32_t* list = lists.of_lane(slot, 0);
    std::uint32_t others[NearSearch::at_once];
    FC_UNROLL
    for (std::uint32_t k = 0; k < NearSearch::at_once; ++k) others[k] = list[std::int64_t(k) * lists.stride()];
    const std::uint32_t stamp = is_first ? 0 : strays.stamp_near(position);
    const std::uint32_t count = lists.counts[slot];
    if (count > lists.rows) return NearRecord::unknown;  // also with the bit of a stray
    const NearSearch search{grid.position_radius, grid.period, position, self.w + sorted.law.reach};
    std::uint32_t found = 0;
    for (std::uint32_t begin = 0; begin < count; begin += NearSearch::at_once) {
      Vec4 there[NearSearch::at_once];
      FC_UNROLL
      for (std::uint32_t k = 0; k < NearSearch::at_once; ++k) {
        if (begin > 0 && begin + k < count) others[k] = list[std::int64_t(begin + k) * lists.stride()];
        there[k] = grid.position_radius[begin + k < count ? others[k] : static_cast<std::uint32_t>(slot)];
      }
      FC_UNROLL
      for (std::uint32_t k = 0; k < NearSearch::at_once; ++k) {
        if (begin + k >= count || !search.is_near(there[k])) continue;
        if (found < NearRecord::places) near(found) = others[k];
        ++found;
      }
    }
    if (!is_first && stamp == strays.stamp()) {
      auto look_at = [&](std::uint32_t stray) {
        if (stray != slot && search.is_near(grid.position_radius[stray])) found = NearRecord::places + 1;
      };
      if (const std::uint64_t head = strays.head_near(position); head != 0) strays.visit(head, look_at);
    }
    return found <= NearRecord::places ? found : NearRecord::unknown;
  }

  // Calls found(other) for all that are near; any number of lanes share the list.
  template <class Found>
  FC_HOST_DEVICE void visit_shared(const GridView& grid, std::int64_t slot, Vec4 self, Lane lane, Found& found) const {
    const Vec3 position{self.x, self.y, self.z};
    const NearSearch search{grid.position_radius, grid.period, position, self.w + sorted.law.reach};
    auto look_at = [&](std::uint32_t other) {
      if (search.is_near(grid.position_radius[other])) found(other);
    };
    const std::uint32_t count = lists.counts[slot], wanted = FrameLists::without_bits(count);
    if (wanted > lists.places_of(slot, wanted)) {
      visit_grid(grid, slot, lane, look_at);
    } else {
      const std::uint32_t in_rows = lists.places();
      const std::uint32_t* chunk = wanted > in_rows ? lists.entries_of_chunk(lists.chunk_of_slot[slot]) : nullptr;
      for (auto k = static_cast<std::uint32_t>(lane.index); k < wanted; k += static_cast<unsigned>(lane.count)) {
        look_at(k < in_rows ? lists.entry(slot, k) : chunk[k - in_rows]);
      }
    }
    const std::uint64_t head = is_first ? 0 : strays.head_near(position);
    const bool is_stray = count != wanted;
    if (is_stray || head != 0) visit_unlisted(grid, slot, position, lane, is_stray, head, found);
  }

 private:
  // What the list should hold.
  template <class Visit>
  FC_HOST_DEVICE void visit_grid(const GridView& grid, std::int64_t slot, Lane lane, Visit& visit) const {
    const Vec4 self = sorted.balls[slot];
    auto visit_listed = [&](std::uint32_t other, Vec4 there) {
      if (other != slot && are_listed(self, there, grid.period, sorted.law.reach)) visit(other);
    };
    visit_sorted(sorted, {self.x, self.y, self.z}, sorted.search_range(self), lane, visit_listed);
  }

  // Behind the list, from `row` on, for this pass alone: what only strays bring near. Returns how many.
  FC_HOST_DEVICE std::uint32_t write_unlisted(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane,
                                              std::uint32_t* list, std::uint32_t*& chunk, std::uint32_t row,
                                              bool may_be_stray, std::uint64_t head) const {
    std::uint32_t found = 0;
    bool may_ask = lane.count == 1;  // for a chunk, once
    auto write = [&](std::uint32_t other) {
      const std::uint32_t here = row + found;
      if (here < lists.rows) {
        list[std::int64_t(here) * lists.stride()] = other;
        ++found;
        return;
      }
      if (chunk == nullptr && may_ask) {
        may_ask = false;
        const std::uint32_t taken = lists.take_chunk(strays.control);
        if (taken > 0) chunk = lists.entries_of_chunk(taken);
      }
      if (chunk != nullptr && here < lists.rows + FrameLists::chunk_places) {
        chunk[here - lists.rows] = other;
        ++found;
        return;
      }
      atomic_max(&strays.control->longest, (here + 1) << lists.lane_bits);
    };
    visit_unlisted(grid, slot, position, lane, may_be_stray, head, write);
    return found;
  }

  // Calls found(other) for those that are near and not listed. Where many are strays, a coarse cell has far more of
  // them than are near.
  template <class Found>
  FC_HOST_DEVICE void visit_unlisted(const GridView& grid, std::int64_t slot, Vec3 position, Lane lane,
                                     bool may_be_stray, std::uint64_t head, Found& found) const {
    const Vec4 self = sorted.balls[slot];
    const float radius = grid.position_radius[slot].w, range = radius + sorted.law.reach;
    const Vec3 drifted = strays.control->drift * age, start = position - drifted;
    const NearSearch search{grid.position_radius, grid.period, position, range};
    auto look_at = [&](std::uint32_t other, Vec4 there) {
      if (other == slot || !search.is_near(there)) return;
      if (!are_listed(self, sorted.balls[other], grid.period, sorted.law.reach)) found(other);
    };
    int turn = 0;
    auto share = [&](std::uint32_t other) {
      if (turn++ % lane.count == lane.index) look_at(other, grid.position_radius[other]);
    };
    if (head != 0) strays.visit(head, share);
    if (!may_be_stray || !is_out_of_skin(self, radius, start, grid.period)) return;
    // A stray finds the others, which are still in their skins, where the sort has put them.
    const NearSearch search_of_skins{sorted.balls, grid.period, start, range};
    auto look_at_skin = [&](std::uint32_t other, Vec4 ball) {
      if (!search_of_skins.is_near(ball)) return;
      const Vec4 there = grid.position_radius[other];
      if (!is_out_of_skin(ball, there.w, Vec3{there.x, there.y, there.z} - drifted, grid.period)) {
        look_at(other, there);
      }
    };
    visit_sorted(sorted, start, range + sorted.law.largest_radius + sorted.law.thickest, lane, look_at_skin);
  }
};

// Writes to the other copy of the slots; a sphere out of its skin becomes a stray of the next pass.
struct ToFrameSlots {
  SlotState to;
  Vec3 period;
  SortedSlots sorted;
  Strays strays;
  std::uint32_t* list_counts;
  float age;          // of the lists after this pass [s]
  Vec4 ball = {};     // of the slot
  Vec3 drifted = {};  // way of its skin since the lists were made [m]

  FC_HOST_DEVICE void assume_walls() {
    period = {0, 0, 0};
    fastcollide::assume_walls(sorted.shape);
    fastcollide::assume_walls(strays.coarse);
  }
  // Loads what write() needs, together with what a pass loads of a slot itself.
  FC_HOST_DEVICE void begin(std::int64_t slot) {
    ball = sorted.balls[slot];
    if (age > 0.0f) drifted = strays.control->drift * age;
  }
  FC_HOST_DEVICE void write(std::int64_t slot, const Sphere& sphere, Vec3 position, Vec3 velocity,
                            const Spin& spin) const {
    to.position_radius[slot] = {position.x, position.y, position.z, sphere.radius};
    to.velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, sphere.restitution};
    if (to.spins != nullptr) to.spins[slot] = spin;
    if (is_out_of_skin(ball, sphere.radius, position - drifted, period)) {
      const std::uint32_t count = list_counts[slot], own = static_cast<std::uint32_t>(slot);
      if ((count & FrameLists::stray_bit) == 0) {
        list_counts[slot] = count | FrameLists::stray_bit | (strays.ask_for_help(own) ? FrameLists::helped_bit : 0u);
      }
      strays.add(own, position, sphere.radius + sorted.law.reach + sorted.law.largest_radius);
    }
    if (slot == 0) strays.control->stray_records[(strays.pass + 1) % 3] = 0;
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t slot, const Sphere&, float value) const { to.crowding[slot] = value; }
};

}  // namespace fastcollide
