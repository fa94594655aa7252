// The stages of listed_step.hpp that a CPU runs in its own way, with vector units.
#pragma once

#include "../backend/cpu.hpp"
#include "../listed_stages.hpp"
#include "../search/slot_search.hpp"
#include "gather_blocks.hpp"

namespace fastcollide {

template <>
class ListedStages<CpuBackend> {
 public:
  explicit ListedStages(CpuBackend& backend)
      : backend_(backend),
        search_slots_(search::search_slots<float>(search::best_simd())),
        functions_(block_functions(search::best_simd())) {}

  void resize(std::int64_t count) {
    stride_ = count + search::slot_padding;
    numbers_.resize(4 * stride_);
    slots_.resize(stride_);
  }

  // By the search that find_contacts() has: it finds each pair once, and both spheres get an entry.
  template <class Run>
  void record_lists(Run& run, ListedWorld& world) {
    const std::int64_t count = world.count;
    const Survey survey = backend_.transform_reduce(count, SurveySlots{world}, Survey{}, Survey::Operation{});
    const search::SlotSearch<float> input = search_input(world, survey.largest_size);
    const bool is_crowded = survey.beside_fixed > most_beside_fixed * count;
    if (is_crowded || meets_twice(input)) return run.for_each(Stage::make_lists, count, record_lists_of(world));
    run.for_each(Stage::make_lists, count, Begin{world, numbers_.data(), slots_.data(), stride_});
    const SlotParts parts(0, count);
    run.for_each_of_groups(Stage::make_lists, parts.as_groups(), Search{input, search_slots_, world, parts});
    run.for_each(Stage::make_lists, count, End{world.lists});
  }

  template <class Run, class Pass>
  void pass_contacts(Run& run, Stage stage, std::int64_t count, const Pass& pass) {
    run.for_each(stage, count, pass);
  }
  template <class Run>
  void pass_contacts(Run& run, Stage stage, std::int64_t count, const GatherContacts<ListedNeighbors, ToSlots>& pass) {
    if (!functions_) return run.for_each(stage, count, pass);
    const SlotParts parts(0, count);
    const GatherBlocks<ListedNeighbors, ToSlots> gather{pass, *functions_};
    run.for_each_of_groups(stage, parts.as_groups(),
                           [&](std::int64_t part) { gather(parts.begin(part), parts.begin(part + 1)); });
  }

 private:
  // As the search compares spheres: a radius with its skin.
  struct SizeInSkin {
    const ListedWorld& world;

    float operator()(std::int64_t slot) const { return world.state.position_radius[slot].w + world.built[slot].w; }
  };

  // The search pairs fixed spheres with each other, too, for nothing; where they lie in each other by the thousands, as
  // those that fill a wall may, that would take longer than all else.
  static constexpr std::int64_t most_beside_fixed = 64;
  struct Survey {
    float largest_size = 0;
    std::int64_t beside_fixed = 0;  // spheres in the cell of a fixed one, for all fixed ones

    struct Operation {
      Survey operator()(const Survey& a, const Survey& b) const {
        return {larger(a.largest_size, b.largest_size), a.beside_fixed + b.beside_fixed};
      }
    };
  };
  struct SurveySlots {
    const ListedWorld& world;

    Survey operator()(std::int64_t slot) const {
      const std::uint32_t* start = world.cell_start + world.sorted_cells[slot];
      return {SizeInSkin{world}(slot), is_fixed(world.mass_ids[slot].mass) ? start[1] - start[0] : 0};
    }
  };

  struct Begin {
    const ListedWorld& world;
    float* numbers;
    std::uint32_t* slots;
    std::int64_t stride;

    void operator()(std::int64_t slot) const {
      const Vec4 start = world.built[slot];
      numbers[slot] = start.x;
      numbers[slot + stride] = start.y;
      numbers[slot + 2 * stride] = start.z;
      numbers[slot + 3 * stride] = SizeInSkin{world}(slot);
      slots[slot] = static_cast<std::uint32_t>(slot);
      world.lists.counts[slot] = {0, 0};
    }
  };

  struct Search {
    const search::SlotSearch<float>& input;
    search::SearchSlots<float> search_slots;
    const ListedWorld& world;
    SlotParts parts;

    void operator()(std::int64_t part) const {
      search_slots(input, parts.begin(part), parts.begin(part + 1), {const_cast<Search*>(this), take});
    }
    static void take(void* context, std::int64_t hits, const std::uint32_t* searchers, const std::uint32_t* found) {
      const auto& self = *static_cast<const Search*>(context);
      for (std::int64_t k = 0; k < hits; ++k) {
        self.add(searchers[k], found[k]);
        self.add(found[k], searchers[k]);
      }
    }
    void add(std::uint32_t owner, std::uint32_t entry) const {
      if (is_fixed(world.mass_ids[owner].mass)) return;  // nothing pushes it, so it asks for nobody
      const NeighborLists& lists = world.lists;
      const std::uint32_t place = atomic_add(&lists.counts[owner].pending, 1);
      if (place < lists.capacity) {
        lists.of_row(owner)[std::int64_t(place) * lists.width] = entry;
      } else {
        atomic_max(&world.control->longest, place + 1);
      }
    }
  };

  struct End {
    NeighborLists lists;

    void operator()(std::int64_t slot) const {
      ListCount& count = lists.counts[slot];
      const std::uint32_t kept = count.pending < lists.capacity ? count.pending : lists.capacity;
      count = {kept, kept};
    }
  };

  // Across a short period two spheres may be near in two ways, and a list holds each once.
  static bool meets_twice(const search::SlotSearch<float>& input) {
    const double reach = 2.0 * static_cast<double>(input.grid.levels[0].largest_size);
    const search::Period& period = input.grid.period;
    const auto is_short = [&](double length) { return length > 0 && length <= 2.001 * reach; };
    return is_short(period.x) || is_short(period.y) || is_short(period.z);
  }

  // The grid of the last sort, as the search describes it. The margin makes up for rounding, here and in are_listed():
  // no pair that is listed may be missing.
  search::SlotSearch<float> search_input(const ListedWorld& world, float largest_size) const {
    const auto axis = [](const GridAxis& a) {
      return search::CellAxis<float>{a.origin, a.inverse_edge, a.cells, a.boundary == Boundary::open};
    };
    const Box& box = world.frame.substep.box;
    const Vec3 period = period_of(box);
    const float margin =
        world.skin.reach + 2e-6f * (2.0f * largest_size + world.skin.reach) + 1e-6f * (period.x + period.y + period.z);
    search::SlotSearch<float> input{};
    search::SearchGrid<float>& grid = input.grid;
    grid.level_count = 1;
    grid.levels[0] = {axis(world.shape.x), axis(world.shape.y), axis(world.shape.z),
                      (largest_size + 0.5f * margin) * 1.000001f, 0};
    grid.cell_count = static_cast<std::uint32_t>(world.cells);
    grid.half_margin = 0.5 * static_cast<double>(margin);
    grid.bounds = {{box.lower.x, box.lower.y, box.lower.z},
                   {box.upper.x, box.upper.y, box.upper.z},
                   {period.x > 0, period.y > 0, period.z > 0}};
    grid.period = {period.x, period.y, period.z};
    const search::Slots<float> slots{numbers_.data(), stride_, true, slots_.data()};
    input.cell_start = world.cell_start;
    input.sets = {slots, slots, {static_cast<double>(margin), true, grid.period}};
    input.is_one_set = true;
    return input;
  }

  CpuBackend& backend_;
  search::SearchSlots<float> search_slots_;
  std::optional<BlockFunctions> functions_;
  std::int64_t stride_ = 0;
  CpuBackend::Buffer<float> numbers_{backend_};
  CpuBackend::Buffer<std::uint32_t> slots_{backend_};
};

}  // namespace fastcollide
