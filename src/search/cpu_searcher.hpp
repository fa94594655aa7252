// The fast form of the search on a CPU. It finds what GenericSearcher finds.
#pragma once

#include <atomic>
#include <limits>
#include <span>

#include "bucket_sort.hpp"
#include "problem.hpp"
#include "slot_search.hpp"
#include "sort_within_rows.hpp"
#include "survey.hpp"
#include "word_lists.hpp"

namespace fastcollide::search {

template <class T>
class CpuSearcher {
 public:
  // Rows twice as wide as the reach: four runs of slots around a sphere, each long enough for wide vector units.
  static constexpr CellEdges edges{0.5, 2.0};
  static constexpr std::int64_t group_size = quick_group;
  static constexpr bool needs_offsets = false;  // of rows, to find their entries

  explicit CpuSearcher(CpuBackend& backend)
      : slabs_(backend.threads()), backend_(backend), simd_(best_simd()), search_slots_(search_slots<T>(simd_)) {}

  void build(const Problem<T>& problem) {
    const bool has_radii = problem.targets.radii != nullptr || problem.spheres.radii != nullptr;
    order(problem.targets, problem.grid, has_radii, false, targets_);
    // Another set searches in the order of its own places, so that what it reads stays in the cache.
    if (!problem.is_one_set) order(problem.spheres, problem.grid, has_radii, true, searchers_);
  }

  // Indices in the order of slots, of the last problem that was built; searchers are those of another set.
  const std::uint32_t* target_ids() const { return targets_.ids.data(); }
  const std::uint32_t* searcher_ids() const { return searchers_.ids.data(); }

  std::int64_t count(const Problem<T>& problem) {
    std::atomic<std::int64_t> total = 0;
    search(problem, [&](int) {
      return [&total](std::int64_t hits, const std::uint32_t*, const std::uint32_t*) {
        total.fetch_add(hits, std::memory_order_relaxed);
      };
    });
    return total;
  }

  void count_rows(const Problem<T>& problem, Rows rows, std::int64_t* counts) {
    const bool both = problem.is_one_set && rows == Rows::both;
    search(problem, [=](int) {
      return [=](std::int64_t hits, const std::uint32_t* searchers, const std::uint32_t* found) {
        for (std::int64_t k = 0; k < hits; ++k) {
          const std::uint32_t i = searchers[k], j = found[k];
          atomic_add(counts + (problem.is_one_set && !both ? std::min(i, j) : i), 1);
          if (both) atomic_add(counts + j, 1);
        }
      };
    });
  }

  // Offsets of the rows, one more than rows (or null: nobody asks for them), and through allocate(total) their entries,
  // ascending.
  template <class Refuse, class Allocate>
  std::int64_t find(const Problem<T>& problem, Rows rows, std::int64_t* offsets, const Refuse& refuse_if_too_many,
                    const Allocate& allocate) {
    // A word has a row, counted from the first of its bucket, and a column: mostly 32 bits are enough for both.
    const Buckets buckets(problem.spheres.count);
    const int column_bits = std::bit_width(static_cast<std::uint64_t>(problem.targets.count - 1));
    return buckets.shift + column_bits <= 32
               ? find(problem, rows, {buckets, column_bits}, short_lists_, offsets, refuse_if_too_many, allocate)
               : find(problem, rows, {buckets, 32}, long_lists_, offsets, refuse_if_too_many, allocate);
  }

 private:
  // Spheres in the order of (cell, index), and where each cell begins.
  struct Order {
    explicit Order(CpuBackend& backend) : numbers(backend), ids(backend), cell_start(backend) {}

    CpuBackend::Buffer<T> numbers;  // x, y, z and radii, as Slots has them
    std::int64_t stride = 0;
    bool has_radii = false;
    CpuBackend::Buffer<std::uint32_t> ids, cell_start;

    Slots<T> slots() const { return {numbers.data(), stride, has_radii, ids.data()}; }
  };

  struct WordFormat {
    Buckets buckets;
    int column_bits;
  };

  template <class Word>
  struct WordMaker {
    int shift, column_bits;

    typename WordLists<Word>::Entry operator()(std::uint32_t row, std::uint32_t column) const {
      const std::uint32_t bucket = row >> shift;
      return {bucket, static_cast<Word>(static_cast<Word>(row - (bucket << shift)) << column_bits | column)};
    }
  };

  static constexpr std::int64_t many_words = std::int64_t(1) << 26;

  template <class Word, class Refuse, class Allocate>
  std::int64_t find(const Problem<T>& problem, Rows rows, const WordFormat& format,
                    std::vector<WordLists<Word>>& known_lists, std::int64_t* offsets, const Refuse& refuse_if_too_many,
                    const Allocate& allocate) {
    const auto workers = static_cast<std::size_t>(this->workers(problem));
    while (known_lists.size() < workers) known_lists.emplace_back(backend_);
    const auto lists = std::span(known_lists).first(workers);
    std::int64_t total = collect(problem, rows, format, lists, many_words);
    if (total > many_words) {
      // So long a list may be longer than the memory: it is counted before it is written.
      for (WordLists<Word>& list : lists) list.release();
      refuse_if_too_many(count(problem) * (problem.is_one_set && rows == Rows::both ? 2 : 1));
      total = collect(problem, rows, format, lists, std::numeric_limits<std::int64_t>::max());
    }
    refuse_if_too_many(total);
    const Columns columns = allocate(total);
    const Buckets& buckets = format.buckets;
    places_.resize(static_cast<std::size_t>(buckets.count) + 1);
    std::int64_t place = 0;
    for (std::int64_t bucket = 0; bucket < buckets.count; ++bucket) {
      places_[static_cast<std::size_t>(bucket)] = place;
      for (const WordLists<Word>& list : lists) place += list.count(bucket);
    }
    places_[static_cast<std::size_t>(buckets.count)] = place;
    slabs_.run(slabs_.count(buckets.count, 4, 4), buckets.count, [&](int, std::int64_t begin, std::int64_t end) {
      BucketSpace<Word> space(backend_);
      for (std::int64_t bucket = begin; bucket < end; ++bucket) {
        lay_out_rows<Word>(bucket, problem.spheres.count, format, lists, space, offsets, columns);
      }
    });
    if (offsets != nullptr) offsets[0] = 0;
    return total;
  }

  int search_slabs(const Problem<T>& problem) const { return slabs_.count(problem.spheres.count, 512, 32); }

  int workers(const Problem<T>& problem) const { return std::min(backend_.threads(), search_slabs(problem)); }

  // make_sink(worker) gives what receives the hits of a worker; each takes the next slab until none is left, and then
  // calls finish(worker).
  template <class MakeSink, class Finish>
  void search(const Problem<T>& problem, const MakeSink& make_sink, const Finish& finish) {
    const Order& from = problem.is_one_set ? targets_ : searchers_;
    const SlotSearch<T> input{
        problem.grid, targets_.cell_start.data(), {from.slots(), targets_.slots(), problem.reach}, problem.is_one_set};
    const std::int64_t n = problem.spheres.count, slabs = search_slabs(problem);
    const int workers = this->workers(problem);
    std::atomic<std::int64_t> next = 0;
    slabs_.run(workers, workers, [&](int worker, std::int64_t, std::int64_t) {
      auto sink = make_sink(worker);
      using Sink = decltype(sink);
      const auto take = [](void* context, std::int64_t hits, const std::uint32_t* searchers,
                           const std::uint32_t* found) { (*static_cast<Sink*>(context))(hits, searchers, found); };
      for (std::int64_t slab; (slab = next++) < slabs;) {
        search_slots_(input, n * slab / slabs, n * (slab + 1) / slabs, {&sink, take});
      }
      finish(worker);
    });
  }
  template <class MakeSink>
  void search(const Problem<T>& problem, const MakeSink& make_sink) {
    search(problem, make_sink, [](int) {});
  }

  // Writes a word for each entry of a row, and returns their number. Gives up if there are more than `most`.
  template <class Word>
  std::int64_t collect(const Problem<T>& problem, Rows rows, const WordFormat& format, std::span<WordLists<Word>> lists,
                       std::int64_t most) {
    const bool both = problem.is_one_set && rows == Rows::both, is_one_set = problem.is_one_set;
    for (WordLists<Word>& list : lists) list.clear(format.buckets.count);
    std::atomic<std::int64_t> written = 0;
    const auto make_sink = [&, most](int worker) {
      return [=, &written, list = &lists[static_cast<std::size_t>(worker)], shift = format.buckets.shift,
              column_bits = format.column_bits](std::int64_t hits, const std::uint32_t* searchers,
                                                const std::uint32_t* found) {
        if (written.fetch_add(both ? 2 * hits : hits, std::memory_order_relaxed) > most) return;
        const WordMaker<Word> make{shift, column_bits};
        if (!is_one_set) return list->add(hits, [=](std::int64_t k) { return make(searchers[k], found[k]); });
        if (both) {
          list->add(hits, [=](std::int64_t k) { return make(searchers[k], found[k]); });
          return list->add(hits, [=](std::int64_t k) { return make(found[k], searchers[k]); });
        }
        list->add(hits, [=](std::int64_t k) {
          // The smaller one first, without a branch that nothing could predict.
          const std::uint32_t i = searchers[k], j = found[k];
          const std::uint32_t exchanged = (i ^ j) & (0u - static_cast<std::uint32_t>(j < i));
          return make(i ^ exchanged, j ^ exchanged);
        });
      };
    };
    search(problem, make_sink, [&](int worker) { lists[static_cast<std::size_t>(worker)].close(); });
    return written;
  }

  // A sphere on its way into its cell. It takes its numbers along: to fetch them at the end, in no order, takes longer.
  // Its tag has its cell, counted from the first of the bucket, and its index: mostly 32 bits are enough for both.
  template <class Tag, bool has_radius>
  struct Traveller;
  template <class Tag>
  struct Traveller<Tag, false> {
    Point<T> position;
    Tag tag;
  };
  template <class Tag>
  struct Traveller<Tag, true> {
    Point<T> position;
    T radius;
    Tag tag;
  };

  // Sorts spheres by (cell, index) and copies them there. Searchers have no level of their own: the finest serves.
  void order(const SpheresIn<T>& spheres, const SearchGrid<T>& grid, bool has_radii, bool are_searchers, Order& to) {
    const Buckets buckets(grid.cell_count);
    const int index_bits = std::bit_width(static_cast<std::uint64_t>(spheres.count - 1));
    const bool is_short = buckets.shift + index_bits <= 32;
    if (has_radii) {
      if (is_short) return order<std::uint32_t, true>(spheres, grid, buckets, index_bits, are_searchers, to);
      return order<std::uint64_t, true>(spheres, grid, buckets, index_bits, are_searchers, to);
    }
    if (is_short) return order<std::uint32_t, false>(spheres, grid, buckets, index_bits, are_searchers, to);
    order<std::uint64_t, false>(spheres, grid, buckets, index_bits, are_searchers, to);
  }

  template <class Tag, bool has_radii>
  void order(const SpheresIn<T>& spheres, const SearchGrid<T>& grid, const Buckets& buckets, int index_bits,
             bool are_searchers, Order& to) {
    using Entry = Traveller<Tag, has_radii>;
    const std::int64_t n = spheres.count;
    to.ids.resize(n + slot_padding);
    to.has_radii = has_radii;
    to.stride = n + slot_padding;
    to.numbers.resize((has_radii ? 4 : 3) * to.stride);
    to.cell_start.resize(std::int64_t(grid.cell_count) + 1);
    to.cell_start.data()[0] = 0;
    cells_.resize(n);
    const int parts = slabs_.count(n, 4096, 2);
    sort_.sort<Entry>(
        slabs_, buckets, grid.cell_count, parts, n,
        [&](int slab, std::int64_t* counts) {
          const std::int64_t begin = n * slab / parts, end = n * (slab + 1) / parts;
          std::uint32_t* cells = cells_.data();
          if (grid.level_count == 1) {
            number_cells(spheres, grid.levels[0], begin, end, cells);
          } else {
            for (std::int64_t i = begin; i < end; ++i) {
              const int k = are_searchers ? grid.level_count - 1 : level_of(spheres.radius(i), grid);
              cells[i] = cell_of(spheres.position(i), grid.levels[k]);
            }
          }
          for (std::int64_t i = begin; i < end; ++i) ++counts[cells[i] >> buckets.shift];
        },
        [&](int slab, std::int64_t* next, Entry* travellers) {
          const SpheresIn<T> from = spheres;  // of this function alone: what is written cannot change it
          const std::uint32_t* cells = cells_.data();
          const std::uint32_t mask = (std::uint32_t(1) << buckets.shift) - 1;
          const int shift = buckets.shift, bits = index_bits;
          for (std::int64_t i = n * slab / parts, end = n * (slab + 1) / parts; i < end; ++i) {
            const std::uint32_t cell = cells[i];
            Entry one;
            one.position = from.position(i);
            if constexpr (has_radii) one.radius = from.radius(i);
            one.tag = static_cast<Tag>(static_cast<Tag>(cell & mask) << bits | static_cast<Tag>(i));
            Entry* to_place = travellers + next[cell >> shift]++;
            search::fetch_to_write(to_place + line_bytes / sizeof(Entry));
            *to_place = one;
          }
        },
        [&](std::int64_t first_cell, std::int64_t end_cell, std::int64_t place, const Entry* begin, const Entry* end) {
          // While a cell's spheres are placed, the start of the next one is where the next sphere goes.
          std::uint32_t* next = to.cell_start.data() + 1 + first_cell;
          const std::int64_t cell_count = end_cell - first_cell;
          const int bits = index_bits;
          std::uint32_t* ids = to.ids.data();
          T* numbers = to.numbers.data();
          const std::int64_t stride = to.stride;
          fetch_to_write(ids + place, end - begin);
          for (int k = 0; k < (has_radii ? 4 : 3); ++k) fetch_to_write(numbers + place + k * stride, end - begin);
          std::fill(next, next + cell_count, 0u);
          for (const Entry* one = begin; one != end; ++one) ++next[one->tag >> bits];
          auto sum = static_cast<std::uint32_t>(place);
          for (std::int64_t cell = 0; cell < cell_count; ++cell) {
            const std::uint32_t count = next[cell];
            next[cell] = sum;
            sum += count;
          }
          const auto index_mask = static_cast<std::uint32_t>((std::uint64_t(1) << index_bits) - 1);
          for (const Entry* one = begin; one != end; ++one) {
            const std::uint32_t slot = next[one->tag >> bits]++;
            ids[slot] = static_cast<std::uint32_t>(one->tag) & index_mask;
            numbers[slot] = one->position.x;
            numbers[slot + stride] = one->position.y;
            numbers[slot + 2 * stride] = one->position.z;
            if constexpr (has_radii) numbers[slot + 3 * stride] = one->radius;
          }
        });
  }

  static constexpr std::int64_t line_bytes = 64;

  template <class U>
  static void fetch_to_write(const U* begin, std::int64_t count) {
    for (std::int64_t k = 0; k < count; k += line_bytes / sizeof(U)) search::fetch_to_write(begin + k);
  }

  // Block by block, in loops that compilers turn into vector instructions.
  static void number_cells(const SpheresIn<T>& spheres, const Level<T>& level, std::int64_t begin, std::int64_t end,
                           std::uint32_t* cells) {
    constexpr std::int64_t block = 64;
    std::array<T, block> x, y, z;
    std::array<int, block> cell_x, cell_y, cell_z;
    for (; begin < end; begin += block) {
      const std::int64_t count = std::min(block, end - begin);
      const auto load = [&](std::int64_t step, std::int64_t component) {
        const T* p = spheres.positions + begin * step;
        for (std::int64_t i = 0; i < count; ++i) {
          x[i] = p[i * step];
          y[i] = p[i * step + component];
          z[i] = p[i * step + 2 * component];
        }
      };
      if (spheres.position_step == 3 && spheres.component_step == 1) {
        load(3, 1);
      } else {
        load(spheres.position_step, spheres.component_step);
      }
      const auto find_cells = [count](const CellAxis<T>& axis, const auto& places, auto& numbers) {
        if (axis.goes_round) {
          for (std::int64_t i = 0; i < count; ++i) numbers[i] = cell_at(places[i], axis);
        } else {
          for (std::int64_t i = 0; i < count; ++i) numbers[i] = clamped_cell(places[i], axis);
        }
      };
      find_cells(level.x, x, cell_x);
      find_cells(level.y, y, cell_y);
      find_cells(level.z, z, cell_z);
      for (std::int64_t i = 0; i < count; ++i) {
        cells[begin + i] = level.first_cell + static_cast<std::uint32_t>(cell_x[i]) +
                           static_cast<std::uint32_t>(level.x.cells) *
                               static_cast<std::uint32_t>(cell_y[i] + level.y.cells * cell_z[i]);
      }
    }
  }

  // Memory to lay out a bucket in.
  template <class Word>
  struct BucketSpace {
    explicit BucketSpace(CpuBackend& backend) : words(backend), ranks(backend), starts(backend) {}

    CpuBackend::Buffer<Word> words, ranks, starts;
  };

  // Puts the words of a bucket in order: the offsets of its rows, if wanted, and what each word says.
  // Not inline: within the function that runs slabs, GCC 12 keeps fewer of its pointers in registers (5 % of a search).
  template <class Word>
  [[gnu::noinline]] void lay_out_rows(std::int64_t bucket, std::int64_t row_count, const WordFormat& format,
                                      std::span<const WordLists<Word>> lists, BucketSpace<Word>& space,
                                      std::int64_t* offsets, const Columns& to) const {
    const int shift = format.buckets.shift, column_bits = format.column_bits;
    const std::int64_t first_row = bucket << shift, rows = std::min((bucket + 1) << shift, row_count) - first_row;
    const std::int64_t place = places_[static_cast<std::size_t>(bucket)],
                       words = places_[static_cast<std::size_t>(bucket) + 1] - place;
    // visit(words, ranks, count) for each chunk of words, and as many ranks.
    const auto visit_chunks = [&](const auto& visit) {
      Word* ranks = space.ranks.data();
      for (const WordLists<Word>& list : lists) {
        list.visit_words(bucket, [&](const Word* some, std::int64_t count) {
          visit(some, ranks, count);
          ranks += count;
        });
      }
    };
    // Each word gets its rank in its row as the row is counted, and with it its place: counters that move on while
    // words are placed would make each wait for the one before. Words of a bucket differ, so a word can count them.
    space.words.resize(words + sort_padding);
    space.ranks.resize(words);
    space.starts.resize(rows);
    Word *sorted = space.words.data(), *starts = space.starts.data();
    std::fill(starts, starts + rows, Word(0));
    visit_chunks([=](const Word* some, Word* ranks, std::int64_t count) {
      for (std::int64_t k = 0; k < count; ++k) ranks[k] = starts[some[k] >> column_bits]++;
    });
    Word sum = 0, longest = 0;
    for (std::int64_t row = 0; row < rows; ++row) {
      const Word count = starts[row];
      longest = std::max(longest, count);
      starts[row] = sum;
      sum += count;
    }
    visit_chunks([=](const Word* some, const Word* ranks, std::int64_t count) {
      for (std::int64_t k = 0; k < count; ++k) sorted[starts[some[k] >> column_bits] + ranks[k]] = some[k];
    });
    if (offsets != nullptr) {
      std::int64_t* begin_of_next = offsets + first_row;
      for (std::int64_t row = 1; row < rows; ++row) begin_of_next[row] = place + static_cast<std::int64_t>(starts[row]);
      begin_of_next[rows] = place + words;
    }
    sort_within_rows(sorted, words, static_cast<std::int64_t>(longest), simd_);

    const Word column_mask = static_cast<Word>((std::uint64_t(1) << column_bits) - 1);
    for (std::int64_t k = 0; k < words; ++k) to.columns[place + k] = static_cast<std::int32_t>(sorted[k] & column_mask);
    if (to.rows == nullptr) return;
    const auto first = static_cast<std::uint32_t>(first_row);
    for (std::int64_t k = 0; k < words; ++k) {
      to.rows[place + k] = static_cast<std::int32_t>(static_cast<std::uint32_t>(sorted[k] >> column_bits) + first);
    }
  }

  Slabs slabs_;
  CpuBackend& backend_;
  Simd simd_;
  SearchSlots<T> search_slots_;
  Order targets_{backend_}, searchers_{backend_};
  CpuBackend::Buffer<std::uint32_t> cells_{backend_};
  BucketSort sort_{backend_};
  std::vector<WordLists<std::uint32_t>> short_lists_;  // of each worker
  std::vector<WordLists<std::uint64_t>> long_lists_;
  std::vector<std::int64_t> places_;  // of the first word of each bucket, among all
};

}  // namespace fastcollide::search
