// The candidates of an earlier search: all pairs that were within a reach longer by the skin. While no sphere has
// strayed far from where it was, every contact is among them, and the grid need not be built again. (L. Verlet, Phys.
// Rev. 159, 98, 1967, with his list's age replaced by what the spheres have really done.)
//
// It answers as a searcher does. Candidates are decided as the search decides, so what is left of them is what a new
// search would find. They are looked at in the order of the grid, where spheres that are near lie near in memory, and
// marked in a list that is in the order of the result.
#pragma once

#include <bit>

#include "problem.hpp"
#include "survey.hpp"

namespace fastcollide::search {

FC_HOST_DEVICE inline int lowest_bit_of(std::uint64_t bits) {
#if defined(__CUDA_ARCH__)
  return __ffsll(static_cast<long long>(bits)) - 1;
#else
  return std::countr_zero(bits);
#endif
}

// The farthest that one of some spheres has gone, and the most that one has grown.
struct Stray {
  double squared_distance = 0, growth = 0;

  FC_HOST_DEVICE double most() const { return square_root(squared_distance) + growth; }

  struct Combine {
    FC_HOST_DEVICE Stray operator()(Stray a, Stray b) const {
      return {a.squared_distance > b.squared_distance ? a.squared_distance : b.squared_distance,
              a.growth > b.growth ? a.growth : b.growth};
    }
  };
};

// Where spheres are, in the order of slots.
template <class T>
struct Places {
  Point<T>* positions;
  T* radii;  // or null
};

// Copies the spheres of a group of slots and tells how far they have strayed from where they were.
template <class T>
struct GatherSlots {
  SpheresIn<T> spheres;
  Groups groups;
  const std::uint32_t* ids;  // null: slots are in the order of the input
  Period period;
  Places<T> before, now;

  FC_HOST_DEVICE Stray operator()(std::int64_t group) const {
    const std::int64_t begin = groups.begin(group), end = groups.end(group);
    for (std::int64_t slot = begin; slot < end; ++slot) {
      if (ids != nullptr && slot + far_ahead < groups.count) spheres.fetch(ids[slot + far_ahead]);
      const std::int64_t id = ids == nullptr ? slot : ids[slot];
      now.positions[slot] = spheres.position(id);
      if (spheres.radii != nullptr) now.radii[slot] = spheres.radius(id);
    }
    Stray stray;
    for (std::int64_t slot = begin; slot < end; ++slot) {
      const double squared = squared_length(nearest_offset(before.positions[slot], now.positions[slot], period));
      if (squared > stray.squared_distance) stray.squared_distance = squared;
      if (spheres.radii == nullptr) continue;
      const double growth = static_cast<double>(now.radii[slot]) - static_cast<double>(before.radii[slot]);
      if (growth > stray.growth) stray.growth = growth;
    }
    return stray;
  }
};

struct InvertOrder {
  const std::uint32_t* ids;
  std::uint32_t* slots;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const { slots[ids[slot]] = static_cast<std::uint32_t>(slot); }
};

// slots: of each index; or null, where they are the same.
FC_HOST_DEVICE inline std::uint32_t slot_of(std::int32_t index, const std::uint32_t* slots) {
  return slots == nullptr ? static_cast<std::uint32_t>(index) : slots[index];
}

struct NumberCandidates {
  const std::int32_t* rows;
  const std::uint32_t* slots;
  std::uint32_t *first_slots, *ranks;

  FC_HOST_DEVICE void operator()(std::int64_t rank) const {
    first_slots[rank] = slot_of(rows[rank], slots);
    ranks[rank] = static_cast<std::uint32_t>(rank);
  }
};

struct FindSecondSlots {
  const std::int32_t* columns;
  const std::uint32_t* slots;
  const std::uint32_t* ranks;
  std::uint32_t* second_slots;

  FC_HOST_DEVICE void operator()(std::int64_t k) const { second_slots[k] = slot_of(columns[ranks[k]], slots); }
};

// Candidates in the order of their first slots, and the rank of each in the order of the result.
struct Candidates {
  const std::uint32_t *first_slots, *second_slots, *ranks;
};

template <class T, bool has_radii, bool is_periodic>
struct SiftCandidates {
  Groups groups;
  Candidates candidates;
  Places<T> spheres, targets;
  Reach reach;
  std::uint8_t* is_hit;  // by rank

  FC_HOST_DEVICE void operator()(std::int64_t group) const {
    // A byte that is written might be one of these for all that a compiler knows, so it would read them again each
    // time.
    const Candidates held = candidates;
    const Places<T> from = spheres, to = targets;
    const Reach within = reach;
    std::uint8_t* const flags = is_hit;
    const std::int64_t end = groups.end(group);
    for (std::int64_t k = groups.begin(group); k < end; ++k) {
      const std::uint32_t i = held.first_slots[k], j = held.second_slots[k];
      const Point<T> a = from.positions[i], b = to.positions[j];
      const Point<double> offset = is_periodic ? nearest_offset(a, b, within.period) : offset_between(a, b, {0, 0, 0});
      const T radius_a = has_radii && from.radii != nullptr ? from.radii[i] : T(0);
      const T radius_b = has_radii && to.radii != nullptr ? to.radii[j] : T(0);
      flags[held.ranks[k]] = is_near_enough(squared_length(offset), radius_a, radius_b, within) ? 1 : 0;
    }
  }
};

struct CountHits {
  Groups groups;
  const std::uint8_t* is_hit;
  std::int64_t* counts;

  FC_HOST_DEVICE void operator()(std::int64_t group) const {
    std::int64_t count = 0;
    for (std::int64_t rank = groups.begin(group); rank < groups.end(group); ++rank) count += is_hit[rank];
    counts[group] = count;
  }
};

struct WriteHits {
  Groups groups;
  const std::int32_t* rows;
  const std::int32_t* columns;
  const std::uint8_t* is_hit;
  const std::int64_t* places;  // of the first hit of each group
  Columns to;

  FC_HOST_DEVICE void operator()(std::int64_t group) const {
    const std::int64_t begin = groups.begin(group), end = groups.end(group);
    std::uint64_t hits = 0;
    for (std::int64_t rank = begin; rank < end; ++rank) hits |= std::uint64_t(is_hit[rank]) << (rank - begin);
    // From one hit to the next, without a guess for each candidate.
    for (std::int64_t place = places[group]; hits != 0; hits &= hits - 1, ++place) {
      const std::int64_t rank = begin + lowest_bit_of(hits);
      to.columns[place] = columns[rank];
      if (to.rows != nullptr) to.rows[place] = rows[rank];
    }
  }
};

struct StartRows {
  Groups rows, groups;
  const std::int64_t* candidate_offsets;
  const std::uint8_t* is_hit;
  const std::int64_t* places;
  std::int64_t* offsets;

  FC_HOST_DEVICE void operator()(std::int64_t row_group) const {
    const std::int64_t begin = rows.begin(row_group), group = candidate_offsets[begin] / groups.size;
    std::int64_t place = places[group], rank = group * groups.size;
    for (std::int64_t row = begin; row < rows.end(row_group); ++row) {
      for (; rank < candidate_offsets[row]; ++rank) place += is_hit[rank];
      offsets[row] = place;
    }
  }
};

struct CountRowsOfHits {
  const std::int32_t* rows;
  const std::int32_t* columns;
  const std::uint8_t* is_hit;
  bool both;  // a pair counts for its second sphere, too
  std::int64_t* counts;

  FC_HOST_DEVICE void operator()(std::int64_t rank) const {
    if (is_hit[rank] == 0) return;
    atomic_add(counts + rows[rank], 1);
    if (both) atomic_add(counts + columns[rank], 1);
  }
};

// Ranks have 32 bits.
inline constexpr std::int64_t most_candidates_kept = (std::int64_t(1) << 32) - 1;

template <Backend B, class T>
class KeptCandidates {
 public:
  explicit KeptCandidates(B& backend) : backend_(backend) {}

  // Whether every pair of this problem must be among the candidates, which were written for rows of this kind.
  bool covers(const Problem<T>& problem, Rows rows) {
    if (!is_whole_ || problem.is_one_set != is_one_set_ || (is_one_set_ && rows != rows_kind_) ||
        !spheres_.fits(problem.spheres) || !(is_one_set_ || targets_.fits(problem.targets)) ||
        !has_same_period(problem.reach.period)) {
      return false;
    }
    const double of_spheres = gather(problem.spheres, spheres_), wider = problem.reach.margin - margin_;
    const double of_targets = is_one_set_ ? of_spheres : gather(problem.targets, targets_);
    return of_spheres + of_targets + (wider > 0 ? wider : 0) <= skin_ - doubt_;
  }

  // Takes the pairs that the searcher finds for `wide`, the problem with a reach that is `skin` longer.
  template <class Searcher, class Refuse>
  void renew(const Problem<T>& problem, const Problem<T>& wide, double widest_reach, Rows rows, double skin,
             Searcher& searcher, const Refuse& refuse_if_too_many) {
    is_whole_ = false;
    is_one_set_ = problem.is_one_set;
    rows_kind_ = rows;
    margin_ = problem.reach.margin;
    period_ = problem.reach.period;
    skin_ = skin;
    // Decisions and distances are rounded to 2^-53, relative, and across a period to that of the period: far less.
    doubt_ = 0x1p-46 * (widest_reach + period_.x + period_.y + period_.z);
    offsets_.resize(problem.spheres.count + 1);
    count_ = searcher.find(wide, rows, offsets_.data(), refuse_if_too_many, [&](std::int64_t candidates) {
      rows_.resize(candidates);
      columns_.resize(candidates);
      return Columns{columns_.data(), rows_.data()};
    });
    remember(problem.spheres, is_one_set_ ? searcher.target_ids() : searcher.searcher_ids(), spheres_);
    if (!is_one_set_) remember(problem.targets, searcher.target_ids(), targets_);
    put_in_order_of_slots();
    is_hit_.resize(count_);
    places_.resize(groups().groups() + 1);
    is_whole_ = true;
  }

  void drop() { is_whole_ = false; }

  // Gives the memory back, too.
  void release() {
    drop();
    for (auto* indices : {&rows_, &columns_}) *indices = Buffer<std::int32_t>(backend_);
    for (auto* words : {&first_slots_, &second_slots_, &ranks_, &unsorted_slots_, &unsorted_ranks_}) {
      *words = Buffer<std::uint32_t>(backend_);
    }
    is_hit_ = Buffer<std::uint8_t>(backend_);
  }

  std::int64_t count(const Problem<T>& problem) { return sift(problem); }

  void count_rows(const Problem<T>& problem, Rows rows, std::int64_t* counts) {
    sift(problem);
    backend_.for_each(count_, CountRowsOfHits{rows_.data(), columns_.data(), is_hit_.data(),
                                              is_one_set_ && rows == Rows::both, counts});
  }

  template <class Refuse, class Allocate>
  std::int64_t find(const Problem<T>& problem, Rows, std::int64_t* offsets, const Refuse& refuse_if_too_many,
                    const Allocate& allocate) {
    const std::int64_t total = sift(problem);
    refuse_if_too_many(total);
    const Columns to = allocate(total);
    backend_.for_each(groups().groups(),
                      WriteHits{groups(), rows_.data(), columns_.data(), is_hit_.data(), places_.data(), to});
    const Groups rows{problem.spheres.count + 1, spheres_in_group};
    backend_.for_each(rows.groups(),
                      StartRows{rows, groups(), offsets_.data(), is_hit_.data(), places_.data(), offsets});
    return total;
  }

 private:
  template <class U>
  using Buffer = typename B::template Buffer<U>;

  // Spheres in the order of slots, as they were when the candidates were found and as they are.
  struct Slots {
    explicit Slots(B& backend)
        : ids(backend), slots(backend), before(backend), now(backend), radii_before(backend), radii_now(backend) {}

    bool fits(const SpheresIn<T>& spheres) const {
      return before.size() == spheres.count && has_radii == (spheres.radii != nullptr);
    }
    const std::uint32_t* ids_or_null() const { return has_ids ? ids.data() : nullptr; }
    const std::uint32_t* slots_or_null() const { return has_ids ? slots.data() : nullptr; }
    Places<T> places_before() { return {before.data(), has_radii ? radii_before.data() : nullptr}; }
    Places<T> places_now() { return {now.data(), has_radii ? radii_now.data() : nullptr}; }

    Buffer<std::uint32_t> ids, slots;
    Buffer<Point<T>> before, now;
    Buffer<T> radii_before, radii_now;
    bool has_ids = false, has_radii = false;
  };

  // A CPU likes long groups; the threads of a GPU read side by side, and as many flags as fill a sector of memory.
  static constexpr bool is_gpu = B::list_width > 1;
  static constexpr std::int64_t spheres_in_group = is_gpu ? 1 : 64, candidates_in_group = is_gpu ? 32 : 64;

  Groups groups() const { return {count_, candidates_in_group}; }

  bool has_same_period(const Period& period) const {
    return period.x == period_.x && period.y == period_.y && period.z == period_.z;
  }

  double gather(const SpheresIn<T>& spheres, Slots& slots) {
    const Groups groups{spheres.count, spheres_in_group};
    const GatherSlots<T> gather{spheres,           groups, slots.ids_or_null(), period_, slots.places_before(),
                                slots.places_now()};
    return backend_.transform_reduce(groups.groups(), gather, Stray{}, Stray::Combine{}).most();
  }

  void remember(const SpheresIn<T>& spheres, const std::uint32_t* ids, Slots& slots) {
    const std::int64_t n = spheres.count;
    slots.has_ids = ids != nullptr;
    slots.has_radii = spheres.radii != nullptr;
    if (slots.has_ids) {
      slots.ids.resize(n);
      slots.slots.resize(n);
      backend_.copy(slots.ids.data(), ids, n);
      backend_.for_each(n, InvertOrder{ids, slots.slots.data()});
    }
    for (auto* places : {&slots.before, &slots.now}) places->resize(n);
    for (auto* radii : {&slots.radii_before, &slots.radii_now}) radii->resize(slots.has_radii ? n : 0);
    // They have strayed from nowhere yet: the answer says nothing.
    backend_.fill_zero(slots.before.data(), n);
    backend_.fill_zero(slots.radii_before.data(), slots.radii_before.size());
    gather(spheres, slots);
    backend_.copy(slots.before.data(), static_cast<const Point<T>*>(slots.now.data()), n);
    backend_.copy(slots.radii_before.data(), static_cast<const T*>(slots.radii_now.data()), slots.radii_now.size());
  }

  void put_in_order_of_slots() {
    const Slots& targets = is_one_set_ ? spheres_ : targets_;
    for (auto* buffer : {&unsorted_slots_, &unsorted_ranks_, &first_slots_, &second_slots_, &ranks_}) {
      buffer->resize(count_);
    }
    backend_.for_each(count_, NumberCandidates{rows_.data(), spheres_.slots_or_null(), unsorted_slots_.data(),
                                               unsorted_ranks_.data()});
    backend_.sort_pairs(static_cast<const std::uint32_t*>(unsorted_slots_.data()), first_slots_.data(),
                        static_cast<const std::uint32_t*>(unsorted_ranks_.data()), ranks_.data(), count_,
                        std::bit_width(static_cast<std::uint64_t>(spheres_.before.size())));
    backend_.for_each(count_,
                      FindSecondSlots{columns_.data(), targets.slots_or_null(), ranks_.data(), second_slots_.data()});
  }

  template <bool has_radii, bool is_periodic>
  void mark(const Problem<T>& problem) {
    const Places<T> spheres = spheres_.places_now(), targets = is_one_set_ ? spheres : targets_.places_now();
    const Groups groups{count_, spheres_in_group};
    backend_.for_each(groups.groups(), SiftCandidates<T, has_radii, is_periodic>{
                                           groups,
                                           {first_slots_.data(), second_slots_.data(), ranks_.data()},
                                           spheres,
                                           targets,
                                           problem.reach,
                                           is_hit_.data()});
  }

  // Marks the candidates within reach, where spheres are now, and numbers them; returns how many there are.
  std::int64_t sift(const Problem<T>& problem) {
    const bool has_radii = problem.spheres.radii != nullptr || problem.targets.radii != nullptr;
    if (period_.is_any()) {
      has_radii ? mark<true, true>(problem) : mark<false, true>(problem);
    } else {
      has_radii ? mark<true, false>(problem) : mark<false, false>(problem);
    }
    backend_.for_each(groups().groups(), CountHits{groups(), is_hit_.data(), places_.data()});
    backend_.exclusive_scan(places_.data(), groups().groups());
    std::int64_t total = 0;
    backend_.copy_to_host(&total, static_cast<const std::int64_t*>(places_.data()) + groups().groups(), 1);
    return total;
  }

  B& backend_;
  bool is_whole_ = false, is_one_set_ = true;
  Rows rows_kind_ = Rows::once;
  double margin_ = 0, skin_ = 0, doubt_ = 0;
  Period period_;
  Slots spheres_{backend_}, targets_{backend_};
  // Candidates in the order of the result,
  std::int64_t count_ = 0;
  Buffer<std::int64_t> offsets_{backend_};
  Buffer<std::int32_t> rows_{backend_}, columns_{backend_};
  Buffer<std::uint8_t> is_hit_{backend_};
  Buffer<std::int64_t> places_{backend_};  // of the hits of each group
  // and in that of their first slots.
  Buffer<std::uint32_t> first_slots_{backend_}, second_slots_{backend_}, ranks_{backend_};
  Buffer<std::uint32_t> unsorted_slots_{backend_}, unsorted_ranks_{backend_};
};

}  // namespace fastcollide::search
