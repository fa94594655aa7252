// The fast form of the search on a CPU. It finds what GenericSearcher finds.
#pragma once

#include <atomic>
#include <limits>

#include "bucket_sort.hpp"
#include "problem.hpp"
#include "slot_search.hpp"
#include "survey.hpp"

namespace fastcollide::search {

template <class T>
class CpuSearcher {
 public:
  // Rows twice as wide as the reach: four runs of slots around a sphere, each long enough for wide vector units.
  static constexpr CellEdges edges{0.5, 2.0};
  static constexpr std::int64_t group_size = quick_group;

  explicit CpuSearcher(CpuBackend& backend)
      : slabs_(backend.threads()), backend_(backend), search_slots_(search_slots<T>(best_simd())) {}

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

  // Offsets of the rows, one more than rows, and through allocate(total) their entries, ascending.
  template <class Refuse, class Allocate>
  std::int64_t find(const Problem<T>& problem, Rows rows, std::int64_t* offsets, const Refuse& refuse_if_too_many,
                    const Allocate& allocate) {
    const std::int64_t row_count = problem.spheres.count;
    if (!collect(problem, rows, many_words)) {
      // So long a list may be longer than the memory: it is counted before it is written.
      for (WordList& list : found_) list = WordList(backend_);
      refuse_if_too_many(count(problem) * (problem.is_one_set && rows == Rows::both ? 2 : 1));
      collect(problem, rows, std::numeric_limits<std::int64_t>::max());
    }
    std::int64_t total = 0;
    for (const WordList& list : found_) total += list.size;
    refuse_if_too_many(total);
    const Columns columns = allocate(total);
    const Buckets buckets(row_count, std::max(total, row_count));
    const auto part = [&](int slab) {
      const WordList& list = found_[static_cast<std::size_t>(slab)];
      return std::pair(list.words.data(), list.words.data() + list.size);
    };
    sort_.sort(
        slabs_, buckets, row_count, static_cast<int>(found_.size()), total,
        [&](int slab, std::int64_t* counts) {
          const auto [begin, end] = part(slab);
          BucketSort::count(buckets, begin, end, counts);
        },
        part,
        [&](std::int64_t first_row, std::int64_t end_row, std::int64_t place, const std::uint64_t* begin,
            const std::uint64_t* end) {
          thread_local std::vector<std::uint64_t> sorted;
          lay_out_rows(first_row, end_row, place, begin, end, sorted, offsets, columns);
        });
    offsets[0] = 0;
    return total;
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

  static constexpr std::int64_t many_words = std::int64_t(1) << 26;

  struct WordList {
    explicit WordList(CpuBackend& backend) : words(backend) {}

    std::uint64_t* grow(std::int64_t more) {
      const std::int64_t before = size;
      size += more;
      if (size > words.size()) words.resize(std::max(size, 2 * words.size()));
      return words.data() + before;
    }

    CpuBackend::Buffer<std::uint64_t> words;
    std::int64_t size = 0;
  };

  int search_slabs(const Problem<T>& problem) const { return slabs_.count(problem.spheres.count, 512, 8); }

  // make_sink(slab) gives what receives the hits of a slab.
  template <class MakeSink>
  void search(const Problem<T>& problem, const MakeSink& make_sink) {
    const Order& from = problem.is_one_set ? targets_ : searchers_;
    const SlotSearch<T> input{
        problem.grid, targets_.cell_start.data(), {from.slots(), targets_.slots(), problem.reach}, problem.is_one_set};
    slabs_.run(search_slabs(problem), problem.spheres.count, [&](int slab, std::int64_t begin, std::int64_t end) {
      auto sink = make_sink(slab);
      using Sink = decltype(sink);
      const auto take = [](void* context, std::int64_t hits, const std::uint32_t* searchers,
                           const std::uint32_t* found) { (*static_cast<Sink*>(context))(hits, searchers, found); };
      search_slots_(input, begin, end, {&sink, take});
    });
  }

  // Writes a word for each entry of a row, slab by slab. False, and given up, if there are more than `most`.
  bool collect(const Problem<T>& problem, Rows rows, std::int64_t most) {
    const bool both = problem.is_one_set && rows == Rows::both, is_one_set = problem.is_one_set;
    const int slabs = search_slabs(problem);
    while (static_cast<int>(found_.size()) < slabs) found_.emplace_back(backend_);
    for (WordList& list : found_) list.size = 0;
    std::atomic<std::int64_t> written = 0;
    search(problem, [&, most](int slab) {
      WordList* list = &found_[static_cast<std::size_t>(slab)];
      return [=, &written](std::int64_t hits, const std::uint32_t* searchers, const std::uint32_t* found) {
        const std::int64_t added = both ? 2 * hits : hits;
        if (written.fetch_add(added, std::memory_order_relaxed) > most) return;
        std::uint64_t* words = list->grow(added);
        for (std::int64_t k = 0; k < hits; ++k) {
          const std::uint32_t i = searchers[k], j = found[k];
          if (both) {
            words[2 * k] = word_of(i, j);
            words[2 * k + 1] = word_of(j, i);
          } else {
            words[k] = is_one_set ? word_of(std::min(i, j), std::max(i, j)) : word_of(i, j);
          }
        }
      };
    });
    return written <= most;
  }

  // Sorts spheres by (cell, index) and copies them there. Searchers have no level of their own: the finest serves.
  void order(const SpheresIn<T>& spheres, const SearchGrid<T>& grid, bool has_radii, bool are_searchers, Order& to) {
    const std::int64_t n = spheres.count;
    to.ids.resize(n + slot_padding);
    to.has_radii = has_radii;
    to.stride = n + slot_padding;
    to.numbers.resize((has_radii ? 4 : 3) * to.stride);
    to.cell_start.resize(std::int64_t(grid.cell_count) + 1);
    cell_words_.resize(n);
    const int parts = slabs_.count(n, 4096, 2);
    const Buckets buckets(grid.cell_count, n);
    const auto part = [&](int slab) {
      std::uint64_t* words = cell_words_.data();
      return std::pair(words + n * slab / parts, words + n * (slab + 1) / parts);
    };
    sort_.sort(
        slabs_, buckets, grid.cell_count, parts, n,
        [&](int slab, std::int64_t* counts) {
          // Block by block, so that words are counted while they are in the cache.
          constexpr std::int64_t block = 64;
          const auto [begin, end] = part(slab);
          for (std::uint64_t* words = begin; words < end; words += block) {
            const std::int64_t first = words - cell_words_.data(), count = std::min<std::int64_t>(block, end - words);
            if (grid.level_count == 1) {
              number_cells<block>(spheres, grid.levels[0], first, count, words);
            } else {
              for (std::int64_t i = first; i < first + count; ++i) {
                const int k = are_searchers ? grid.level_count - 1 : level_of(spheres.radius(i), grid);
                words[i - first] = word_of(cell_of(spheres.position(i), grid.levels[k]), static_cast<std::uint32_t>(i));
              }
            }
            BucketSort::count(buckets, words, words + count, counts);
          }
        },
        part,
        [&](std::int64_t first_cell, std::int64_t end_cell, std::int64_t place, const std::uint64_t* begin,
            const std::uint64_t* end) {
          // While a cell's spheres are placed, the start of the next one is where the next sphere goes.
          std::uint32_t* next = to.cell_start.data() + 1;
          std::fill(next + first_cell, next + end_cell, 0u);
          for (const std::uint64_t* word = begin; word != end; ++word) ++next[key_of(*word)];
          auto sum = static_cast<std::uint32_t>(place);
          for (std::int64_t cell = first_cell; cell < end_cell; ++cell) {
            const std::uint32_t count = next[cell];
            next[cell] = sum;
            sum += count;
          }
          std::uint32_t* ids = to.ids.data();
          T* numbers = to.numbers.data();
          const std::int64_t stride = to.stride;
          for (const std::uint64_t* word = begin; word != end; ++word) {
            if (end - word > far_ahead) spheres.fetch(static_cast<std::uint32_t>(word[far_ahead]));
            const std::uint32_t slot = next[key_of(*word)]++, id = static_cast<std::uint32_t>(*word);
            const Point<T> p = spheres.position(id);
            ids[slot] = id;
            numbers[slot] = p.x;
            numbers[slot + stride] = p.y;
            numbers[slot + 2 * stride] = p.z;
            if (has_radii) numbers[slot + 3 * stride] = spheres.radius(id);
          }
        });
    to.cell_start.data()[0] = 0;
  }

  // Of up to `block` spheres, in loops that compilers turn into vector instructions.
  template <std::int64_t block>
  static void number_cells(const SpheresIn<T>& spheres, const Level<T>& level, std::int64_t first, std::int64_t count,
                           std::uint64_t* words) {
    std::array<T, block> x, y, z;
    std::array<int, block> cell_x, cell_y, cell_z;
    for (std::int64_t i = 0; i < count; ++i) {
      const Point<T> p = spheres.position(first + i);
      x[i] = p.x;
      y[i] = p.y;
      z[i] = p.z;
    }
    const auto find_cells = [count](const CellAxis<T>& axis, const auto& places, auto& cells) {
      if (axis.goes_round) {
        for (std::int64_t i = 0; i < count; ++i) cells[i] = cell_at(places[i], axis);
      } else {
        for (std::int64_t i = 0; i < count; ++i) cells[i] = clamped_cell(places[i], axis);
      }
    };
    find_cells(level.x, x, cell_x);
    find_cells(level.y, y, cell_y);
    find_cells(level.z, z, cell_z);
    for (std::int64_t i = 0; i < count; ++i) {
      const auto cell = static_cast<std::uint32_t>(cell_x[i]) +
                        static_cast<std::uint32_t>(level.x.cells) *
                            static_cast<std::uint32_t>(cell_y[i] + level.y.cells * cell_z[i]);
      words[i] = word_of(level.first_cell + cell, static_cast<std::uint32_t>(first + i));
    }
  }

  // The words of a bucket in order: the offsets of its rows, and what each word says.
  static void lay_out_rows(std::int64_t first_row, std::int64_t end_row, std::int64_t place, const std::uint64_t* begin,
                           const std::uint64_t* end, std::vector<std::uint64_t>& sorted, std::int64_t* offsets,
                           const Columns& to) {
    sorted.resize(static_cast<std::size_t>(end - begin));
    // While a row's words are placed, the offset of the next one is where the next word of the row goes.
    std::int64_t* next = offsets + 1;
    std::fill(next + first_row, next + end_row, 0);
    for (const std::uint64_t* word = begin; word != end; ++word) ++next[key_of(*word)];
    std::int64_t sum = place, longest = 0;
    for (std::int64_t row = first_row; row < end_row; ++row) {
      const std::int64_t count = next[row];
      longest = std::max(longest, count);
      next[row] = sum;
      sum += count;
    }
    for (const std::uint64_t* word = begin; word != end; ++word) {
      sorted[static_cast<std::size_t>(next[key_of(*word)]++ - place)] = *word;
    }

    // The words are in the order of their rows; in each row those of a few must change places.
    constexpr std::int64_t many = 32;
    if (longest > many) {
      std::sort(sorted.begin(), sorted.end());
    } else {
      sort_nearly_sorted(sorted);
    }
    for (std::size_t k = 0; k < sorted.size(); ++k) {
      to.columns[place + static_cast<std::int64_t>(k)] = static_cast<std::int32_t>(sorted[k] & 0xFFFFFFFFu);
    }
    if (to.rows == nullptr) return;
    for (std::size_t k = 0; k < sorted.size(); ++k) {
      to.rows[place + static_cast<std::int64_t>(k)] = static_cast<std::int32_t>(key_of(sorted[k]));
    }
  }

  static void sort_nearly_sorted(std::vector<std::uint64_t>& words) {
    for (std::size_t place = 1; place < words.size(); ++place) {
      const std::uint64_t held = words[place];
      std::size_t hole = place;
      for (; hole > 0 && words[hole - 1] > held; --hole) words[hole] = words[hole - 1];
      words[hole] = held;
    }
  }

  Slabs slabs_;
  CpuBackend& backend_;
  SearchSlots<T> search_slots_;
  Order targets_{backend_}, searchers_{backend_};
  CpuBackend::Buffer<std::uint64_t> cell_words_{backend_};
  BucketSort sort_{backend_};
  std::vector<WordList> found_;
};

}  // namespace fastcollide::search
