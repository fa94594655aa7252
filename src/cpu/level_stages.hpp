// The stage of level_step.hpp that a CPU runs in its own way, with vector units.
#pragma once

#include "../backend/cpu.hpp"
#include "../level_stages.hpp"
#include "../level_step.hpp"
#include "gather_blocks.hpp"

namespace fastcollide {

template <>
class LevelRun<CpuBackend> : public HostRun<CpuBackend> {
 public:
  LevelRun(CpuBackend& backend, StageTimer& timer)
      : HostRun<CpuBackend>(backend, timer), functions_(block_functions(search::best_simd())) {}

  template <class Pass>
  void for_each_of_groups(Stage stage, const SlotGroups& groups, const Pass& pass) {
    HostRun<CpuBackend>::for_each_of_groups(stage, groups, pass);
  }
  // Large spheres have more who may be near than a block holds.
  template <bool is_rough, bool has_walls>
  void for_each_of_groups(
      Stage stage, const SlotGroups& groups,
      const SharedLevelPass<GatherContacts<LevelNeighbors, ToNextPass>, is_rough, has_walls>& pass) {
    if (!functions_) return HostRun<CpuBackend>::for_each_of_groups(stage, groups, pass);
    const auto contacts = pass.now();
    const GatherBlocks<LevelNeighbors, ToNextPass> gather{contacts, *functions_};
    for (int k = 0; k < groups.count; ++k) {
      const SlotGroup& group = groups.groups[k];
      if (group.lanes > 1) {
        HostRun<CpuBackend>::for_each_of_groups(stage, {{group}, 1}, pass);
        continue;
      }
      const SlotParts parts(group.first, group.count);
      HostRun<CpuBackend>::for_each_of_groups(
          stage, parts.as_groups(), [&](std::int64_t part) { gather(parts.begin(part), parts.begin(part + 1)); });
    }
  }

 private:
  std::optional<BlockFunctions> functions_;
};

}  // namespace fastcollide
