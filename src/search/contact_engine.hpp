// A contact finder on one backend: checks the input, chooses the grid, searches, lays out the result.
#pragma once

#include <algorithm>
#include <limits>
#include <string>
#include <utility>

#include "../text.hpp"
#include "choose_grid.hpp"
#include "engine_interface.hpp"
#include "free_memory.hpp"
#include "kept_candidates.hpp"
#include "result_memory.hpp"
#include "rows_of_neighbors.hpp"

namespace fastcollide::search {

// The names of the arguments in messages.
struct FieldNames {
  const char *positions, *radii;
};
inline constexpr FieldNames names_of_spheres{"positions", "radii"}, names_of_others{"other_positions", "other_radii"};

template <Backend B, template <class> class Searcher>
class ContactEngineOn final : public ContactEngine {
 public:
  ContactEngineOn(B backend, double skin) : backend_(std::move(backend)), skin_(skin) {}

  std::int64_t reuses() const override { return reuses_; }

  std::int64_t count(const SearchInput& input) override {
    return with_type(input, [&]<class T>(Sources<T>& sources) {
      const Turn turn(backend_, input.options.cuda_stream);
      auto problem = prepare<T>(input);
      if (problem.is_empty) return std::int64_t(0);
      return with_source(problem, sources, Rows::once, [&](auto& source) { return source.count(problem.problem); });
    });
  }

  ArrayView counts(const SearchInput& input) override {
    return with_type(input, [&]<class T>(Sources<T>& sources) {
      const Turn turn(backend_, input.options.cuda_stream);
      auto problem = prepare<T>(input);
      Buffer<std::int64_t>& counts = totals_.take(input.spheres.positions.rows);
      backend_.fill_zero(counts.data(), counts.size());
      if (!problem.is_empty) {
        with_source(problem, sources, Rows::once,
                    [&](auto& source) { source.count_rows(problem.problem, Rows::both, counts.data()); });
      }
      return view(counts, 0);
    });
  }

  ContactList contacts(const SearchInput& input, bool is_measured) override {
    return with_type(input, [&]<class T>(Sources<T>& sources) {
      const Turn turn(backend_, input.options.cuda_stream);
      auto problem = prepare<T>(input);
      const std::int64_t rows = input.spheres.positions.rows;
      std::int64_t* offsets = nullptr;
      if (skin_ > 0 || Searcher<T>::needs_offsets) {
        offsets_.resize(rows + 1);
        offsets = offsets_.data();
      }
      const auto [second, first] = find(problem, sources, Rows::once, rows, offsets, true, input.options);
      if (!is_measured) return ContactList{view(*first, 0), view(*second, 0), {}, {}};
      const std::int64_t total = first->size();
      Buffer<T>& gap = sources.reals.take(total);
      Buffer<Point<T>>& normal = sources.points.take(total);
      backend_.for_each(total, MeasureContacts<T>{problem.problem.spheres, problem.problem.targets,
                                                  problem.problem.reach.period, problem.common_radii, total,
                                                  first->data(), second->data(), gap.data(), normal.data()});
      return ContactList{view(*first, 0), view(*second, 0), view(gap, 0), view(normal, 3)};
    });
  }

  NeighborList neighbors(const SearchInput& input, const NeighborOptions& list) override {
    return with_type(input, [&]<class T>(Sources<T>& sources) {
      const Turn turn(backend_, input.options.cuda_stream);
      auto problem = prepare<T>(input);
      const std::int64_t rows = input.spheres.positions.rows;
      Buffer<std::int64_t>* offsets = &totals_.take(rows + 1);
      Buffer<std::int32_t>* columns =
          find(problem, sources, Rows::both, rows, offsets->data(), false, input.options).columns;
      Buffer<T>* distances = nullptr;
      const std::int64_t shortened =
          list.most_neighbors == std::numeric_limits<std::int64_t>::max()
              ? 0
              : backend_.transform_reduce(rows, CountShortened{offsets->data(), list.most_neighbors}, std::int64_t(0),
                                          Sum{});
      if (list.keep_distances || list.sort_by_distance || shortened > 0) {
        distances = &sources.reals.take(columns->size());
        backend_.for_each(
            rows, MeasureDistances<T>{problem.problem.spheres, problem.problem.targets, problem.problem.reach.period,
                                      list.is_squared, offsets->data(), columns->data(), distances->data()});
      }
      const auto sort = [&](bool by_distance) {
        backend_.for_each(rows, SortNeighbors<T>{by_distance, offsets->data(), columns->data(), distances->data()});
      };
      if (list.sort_by_distance || shortened > 0) sort(true);
      // Views hold the longer rows while they are copied, so that none of their memory is taken for the shorter ones.
      NeighborList found{view(*offsets, 0), view(*columns, 0), {}, shortened};
      if (distances != nullptr) found.distances = view(*distances, 0);
      if (shortened > 0) {
        Buffer<std::int64_t>& shorter = totals_.take(rows + 1);
        backend_.for_each(rows, ShortenRows{offsets->data(), list.most_neighbors, shorter.data()});
        backend_.exclusive_scan(shorter.data(), rows);
        std::int64_t total = 0;
        backend_.copy_to_host(&total, static_cast<const std::int64_t*>(shorter.data()) + rows, 1);
        Buffer<std::int32_t>& kept_columns = indices_.take(total);
        Buffer<T>& kept_distances = sources.reals.take(total);
        backend_.for_each(rows, CopyRows<T>{offsets->data(), shorter.data(), columns->data(), distances->data(),
                                            kept_columns.data(), kept_distances.data()});
        backend_.synchronize();  // before the longer rows go
        offsets = &shorter;
        columns = &kept_columns;
        distances = &kept_distances;
        found = {view(*offsets, 0), view(*columns, 0), view(*distances, 0), shortened};
        if (!list.sort_by_distance) sort(false);
      }
      if (!list.keep_distances) found.distances = {};
      return found;
    });
  }

 private:
  template <class U>
  using Buffer = typename B::template Buffer<U>;

  // The caller's stream waits for the search, and the search for what the caller has queued.
  class Turn {
   public:
    Turn(B& backend, void* stream) : backend_(backend), stream_(stream) { backend_.wait_for(stream_); }
    ~Turn() {
      try {
        backend_.let_wait(stream_);
      } catch (const DeviceError&) {  // a failed device has no order to keep; the next call reports it
      }
    }
    Turn(const Turn&) = delete;
    Turn& operator=(const Turn&) = delete;

   private:
    B& backend_;
    void* stream_;
  };

  template <class T>
  struct Prepared {
    Problem<T> problem;
    Survey<T> of_spheres, of_targets;
    bool is_empty;        // no pair can be
    double common_radii;  // twice the radius that all share

    double largest_reach() const { return of_spheres.most_size + of_targets.most_size; }
  };

  // What finds pairs, and where results of this type go.
  template <class T>
  struct Sources {
    explicit Sources(B& backend) : searcher(backend), kept(backend), reals(backend), points(backend) {}

    Searcher<T> searcher;
    KeptCandidates<B, T> kept;
    ResultMemory<B, T> reals;
    ResultMemory<B, Point<T>> points;
  };

  template <class Call>
  auto with_type(const SearchInput& input, const Call& call) {
    return input.spheres.positions.is_double ? call(in_double_) : call(in_single_);
  }

  // use(source) with the candidates that are kept, if they hold, else with a new search.
  template <class T, class Use>
  auto with_source(Prepared<T>& prepared, Sources<T>& sources, Rows rows, const Use& use) {
    if (skin_ > 0 && hold_candidates(prepared, sources, rows)) return use(sources.kept);
    choose_grid_of(prepared.problem, prepared, 0);
    sources.searcher.build(prepared.problem);
    return use(sources.searcher);
  }

  // False where candidates cannot be kept: more than the memory holds, or a period that a longer reach would go round.
  template <class T>
  bool hold_candidates(const Prepared<T>& prepared, Sources<T>& sources, Rows rows) {
    if (sources.kept.covers(prepared.problem, rows)) {
      ++reuses_;
      return true;
    }
    sources.kept.drop();
    const double widest_reach = prepared.largest_reach() + skin_;
    const Period& period = prepared.problem.reach.period;
    for (const double length : {period.x, period.y, period.z}) {
      if (length > 0 && !is_shorter_than_half(widest_reach, length)) return false;
    }
    Problem<T> wide = prepared.problem;
    wide.reach.margin += skin_;
    wide.reach.is_inclusive = true;
    choose_grid_of(wide, prepared, skin_);
    try {
      sources.searcher.build(wide);
      sources.kept.renew(prepared.problem, wide, widest_reach, rows, skin_, sources.searcher, [&](std::int64_t total) {
        refuse_beyond_memory<T>(total);
        if (total > most_candidates_kept) throw OutOfMemory("too many candidates to keep");
      });
    } catch (const OutOfMemory&) {
      sources.kept.release();
      return false;
    }
    return true;
  }

  template <class U>
  ArrayView view(Buffer<U>& buffer, int columns) {
    return {buffer.data(), buffer.size(), columns, backend_.cuda_device(), buffer.share()};
  }

  struct Found {
    Buffer<std::int32_t>*columns, *row_of_each;
  };

  // offsets: of the rows, one more than rows; or null, where nobody needs them.
  template <class T>
  Found find(Prepared<T>& prepared, Sources<T>& sources, Rows rows, std::int64_t row_count, std::int64_t* offsets,
             bool with_row_of_each, const SearchOptions& options) {
    Found found{};
    const auto allocate = [&](std::int64_t total) {
      found.columns = &indices_.take(total);
      const std::shared_ptr<void> held = found.columns->share();  // or the rows would get the same memory
      if (with_row_of_each) found.row_of_each = &indices_.take(total);
      return Columns{found.columns->data(), with_row_of_each ? found.row_of_each->data() : nullptr};
    };
    if (prepared.is_empty) {
      if (offsets != nullptr) backend_.fill_zero(offsets, row_count + 1);
      allocate(0);
      return found;
    }
    const auto refuse_if_too_many = [&](std::int64_t total) {
      if (total > options.most_contacts) {
        throw OutOfMemory("max_contacts: found " + std::to_string(total) + " contacts; allowed: at most " +
                          std::to_string(options.most_contacts));
      }
      refuse_beyond_memory<T>(total);
    };
    with_source(prepared, sources, rows, [&](auto& source) {
      return source.find(prepared.problem, rows, offsets, refuse_if_too_many, [&](std::int64_t total) {
        try {
          return allocate(total);
        } catch (const OutOfMemory& error) {  // which of a GPU's words says how many
          throw OutOfMemory("contacts: found " + std::to_string(total) + "; allowed: as many as fit into the memory (" +
                            error.what() + "; the total and the counts need no list)");
        }
      });
    });
    return found;
  }

  template <class T>
  void refuse_beyond_memory(std::int64_t total) const {
    if (total <= many_entries || total <= room_for(bytes_of_entry<T>)) return;
    throw OutOfMemory("contacts: found " + std::to_string(total) + "; allowed: at most " +
                      std::to_string(room_for(bytes_of_entry<T>)) +
                      " in the memory that is free (the total and the counts need no list)");
  }

  // What a list takes for each entry, with all that is needed on the way. Systems promise more memory than they have
  // and end a process that believes them, so the host is asked first; a CUDA device says no by itself.
  template <class T>
  static constexpr std::int64_t bytes_of_entry = 2 * 8 + 2 * 4 + 4 * sizeof(T);
  static constexpr std::int64_t many_entries = std::int64_t(1) << 22;

  std::int64_t room_for(std::int64_t bytes) const {
    return backend_.cuda_device() < 0 ? free_host_memory() / bytes : std::numeric_limits<std::int64_t>::max();
  }

  // Checks all numbers of the input.
  template <class T>
  Prepared<T> prepare(const SearchInput& input) {
    const SearchOptions& options = input.options;
    const bool is_one_set = input.others == nullptr;
    const SphereArrays& other = is_one_set ? input.spheres : *input.others;
    Prepared<T> prepared{};
    Problem<T>& problem = prepared.problem;
    problem.spheres = spheres_in<T>(input.spheres);
    problem.targets = spheres_in<T>(other);
    problem.is_one_set = is_one_set;
    // A radius that all share is as good as a wider margin, and saves the radii.
    prepared.common_radii = (input.spheres.radii.data == nullptr ? input.spheres.radius : 0) +
                            (other.radii.data == nullptr ? other.radius : 0);
    problem.reach.margin = options.margin + prepared.common_radii;
    problem.reach.is_inclusive = options.is_inclusive;
    double* lengths[3] = {&problem.reach.period.x, &problem.reach.period.y, &problem.reach.period.z};
    Bounds<T> bounds{};
    for (int axis = 0; axis < 3; ++axis) {
      bounds.is_periodic[axis] = options.boundary[axis] == Boundary::periodic;
      if (!bounds.is_periodic[axis]) continue;
      bounds.lower[axis] = static_cast<T>(options.lower[axis]);
      bounds.upper[axis] = static_cast<T>(options.upper[axis]);
      *lengths[axis] = options.upper[axis] - options.lower[axis];
    }

    const double half_margin = 0.5 * problem.reach.margin;
    problem.grid.bounds = bounds;
    prepared.of_spheres = survey(problem.spheres, half_margin, bounds, names_of_spheres);
    prepared.of_targets =
        is_one_set ? prepared.of_spheres : survey(problem.targets, half_margin, bounds, names_of_others);
    check_reach(prepared.largest_reach(), options);
    prepared.is_empty = problem.spheres.count == 0 || problem.targets.count == 0 || !(prepared.largest_reach() > 0);
    return prepared;
  }

  // For the margin of `problem`, which is `more` than the one that the spheres were looked at with.
  template <class T>
  void choose_grid_of(Problem<T>& problem, const Prepared<T>& prepared, double more) {
    const double half_margin = 0.5 * problem.reach.margin;
    const double searcher_size = prepared.of_spheres.most_size + 0.5 * more;
    const double least_size = prepared.of_targets.least_size + 0.5 * more;
    const double most_size = prepared.of_targets.most_size + 0.5 * more;
    Population set{};
    set.count = problem.targets.count;
    set.largest_size = most_size > 0 ? most_size : searcher_size;
    const int base_exponent = exponent_of(set.largest_size);
    if (least_size * 2 > most_size) {
      set.octave_counts[0] = set.count;
    } else {
      const Groups groups{set.count, Searcher<T>::group_size};
      const OctaveCounts counts = backend_.transform_reduce(
          groups.groups(), CountOctaves<T>{problem.targets, groups, half_margin, base_exponent}, OctaveCounts{},
          typename OctaveCounts::Combine{});
      std::copy(std::begin(counts.counts), std::end(counts.counts), set.octave_counts.begin());
    }
    for (int axis = 0; axis < 3; ++axis) {
      set.low[axis] = prepared.of_targets.low[axis];
      set.high[axis] = prepared.of_targets.high[axis];
    }
    if (!problem.is_one_set) {
      set.searcher_count = problem.spheres.count;
      set.searcher_size = searcher_size;
    }
    problem.grid = choose_grid<T>(set, half_margin, problem.grid.bounds, problem.reach.period, Searcher<T>::edges);
  }

  template <class T>
  Survey<T> survey(const SpheresIn<T>& spheres, double half_margin, const Bounds<T>& bounds, const FieldNames& names) {
    const Groups groups{spheres.count, Searcher<T>::group_size};
    const Survey<T> found =
        backend_.transform_reduce(groups.groups(), SurveySpheres<T>{spheres, groups, half_margin, bounds}, Survey<T>{},
                                  typename Survey<T>::Combine{});
    if (found.first_bad != nothing_bad) {
      refuse(spheres, static_cast<std::int64_t>(found.first_bad / 8), static_cast<Bad>(found.first_bad % 8),
             half_margin, bounds, names);
    }
    return found;
  }

  template <class T>
  [[noreturn]] void refuse(const SpheresIn<T>& spheres, std::int64_t i, Bad kind, double half_margin,
                           const Bounds<T>& bounds, const FieldNames& names) {
    T place[3], radius = 0;
    for (int axis = 0; axis < 3; ++axis) {
      backend_.copy_to_host(&place[axis], spheres.positions + i * spheres.position_step + axis * spheres.component_step,
                            1);
    }
    if (spheres.radii != nullptr) backend_.copy_to_host(&radius, spheres.radii + i * spheres.radius_step, 1);
    const std::string where = "(" + text_of(place[0]) + ", " + text_of(place[1]) + ", " + text_of(place[2]) + ")";
    const std::string type = sizeof(T) == 4 ? "float32" : "float64";
    switch (kind) {
      case Bad::not_finite:
        throw InvalidValue(names.positions, i, where, "finite numbers");
      case Bad::radius:
        throw InvalidValue(names.radii, i, text_of(radius), "a finite number, 0 or more");
      case Bad::size:
        throw InvalidValue(names.radii, i, text_of(radius),
                           "radius + margin / 2 of 0, or from " + text_of(smallest_size<T>) + " to " +
                               text_of(largest_size<T>) + " in " + type);
      case Bad::outside: {
        std::string allowed = "inside the bounds along periodic axes:";
        for (int axis = 0; axis < 3; ++axis) {
          if (!bounds.is_periodic[axis]) continue;
          allowed += std::string(" ") + "xyz"[axis] + " from " + text_of(bounds.lower[axis]) + " to " +
                     text_of(bounds.upper[axis]);
        }
        throw InvalidValue(names.positions, i, where, allowed);
      }
      case Bad::unresolved:
        break;
    }
    throw InvalidValue(names.positions, i, where,
                       "up to " + text_of(reach_in_sizes<T> * (static_cast<double>(radius) + half_margin)) +
                           " from 0, " + (sizeof(T) == 4 ? "131072" : "2^46") +
                           " times (radius + margin / 2): " + type + " cannot place this sphere to 1/64 of its radius" +
                           (sizeof(T) == 4 ? "; float64 can" : ""));
  }

  static bool is_shorter_than_half(double reach, double length) { return 2 * reach * (1 + 0x1p-20) < length; }

  void check_reach(double largest_reach, const SearchOptions& options) {
    for (int axis = 0; axis < 3; ++axis) {
      if (options.boundary[axis] != Boundary::periodic) continue;
      const double length = options.upper[axis] - options.lower[axis];
      if (is_shorter_than_half(largest_reach, length)) continue;
      throw InvalidValue("bounds", axis, "a period of " + text_of(length),
                         "more than twice the largest reach (sum of two radii and the margin), " +
                             text_of(largest_reach) + ", so that no two spheres meet twice");
    }
  }

  B backend_;
  double skin_;
  std::int64_t reuses_ = 0;
  Sources<float> in_single_{backend_};
  Sources<double> in_double_{backend_};
  ResultMemory<B, std::int32_t> indices_{backend_};
  ResultMemory<B, std::int64_t> totals_{backend_};
  Buffer<std::int64_t> offsets_{backend_};  // where nobody asks for them
};

}  // namespace fastcollide::search
