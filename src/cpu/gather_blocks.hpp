// The contact pass on a CPU: the near ones of several spheres are collected first, then all their contacts are worked
// on side by side, then each sphere adds up its own. The sums are those of GatherContacts::gather().
#pragma once

#include <algorithm>

#include "../stages/gather_contacts.hpp"
#include "../stages/level_neighbors.hpp"
#include "contact_block.hpp"

namespace fastcollide {

// Slots cut into parts, as a group of things that are worth a slab each: of more than one lane.
struct SlotParts {
  SlotParts(std::int64_t first, std::int64_t slots)
      : first(first), slots(slots), count(std::clamp<std::int64_t>(slots / 256, 1, 64)) {}
  std::int64_t begin(std::int64_t part) const { return first + slots * part / count; }
  SlotGroups as_groups() const { return {{{0, count, 8}}, 1}; }

  std::int64_t first, slots, count;
};

template <class Neighbors, class Output>
struct GatherBlocks {
  using Pass = GatherContacts<Neighbors, Output>;

  const Pass& pass;
  BlockFunctions functions;

  // GCC would leave smaller functions out of line.
  [[gnu::flatten]] void operator()(std::int64_t begin, std::int64_t end) const {
    ContactBlock block;
    std::fill_n(block.others, ContactBlock::room, 0);  // whatever is read there is a slot
    Members members;
    for (std::int64_t slot = begin; slot < end;) {
      members.count = members.pairs = 0;
      members.first = slot;
      while (slot < end && members.count < Members::most && collect(slot, members, block)) ++slot;
      if (slot == members.first) {  // more neighbours than a block holds
        pass(slot++);
        continue;
      }
      if (members.pairs > 0) {
        functions.find_terms(pass.substep, pass.grid.period, pass.grid.spins != nullptr, members.pairs, block);
      }
      for (int i = 0; i < members.count; ++i) finish(i, members, block);
    }
  }

 private:
  // Spheres of a block, one slot after the other, and where the contacts of each end.
  struct Members {
    static constexpr int most = 64;

    std::int64_t first;
    int count, pairs;
    int pairs_end[most];
  };

  // False where the block has too little room for all who are near.
  bool collect(std::int64_t slot, Members& members, ContactBlock& block) const {
    const GridView& grid = pass.grid;
    int end = members.pairs;
    bool has_room = true;
    auto take = [&](const std::uint32_t* list, int listed) {
      has_room = listed <= ContactBlock::size - end;
      if (has_room) {
        end = functions.collect(grid, pass.substep.law.opening_margin, slot, list, listed, end, block);
      }
      return has_room;
    };
    if (!is_fixed(grid.mass_ids[slot].mass)) look_through(pass.neighbors, slot, take);
    if (!has_room) return false;
    members.pairs = members.pairs_end[members.count++] = end;
    return true;
  }

  // Calls take(list, listed) with all who may be near, until it returns false.
  template <class Take>
  void look_through(const ListedNeighbors& neighbors, std::int64_t slot, Take& take) const {
    constexpr std::int64_t far_ahead = 12;  // as lists lie apart, the processor does not see which comes next
    const NeighborLists& lists = neighbors.lists;
    search::fetch_ahead(lists.of_row(std::min(slot + far_ahead, pass.grid.count - 1)));
    neighbors.publish(slot);
    const std::uint32_t listed = lists.counts[slot].pending;
    take(lists.of_row(slot), static_cast<int>(std::min<std::uint32_t>(listed, ContactBlock::size + 1)));
  }
  template <class Take>
  void look_through(const LevelNeighbors& neighbors, std::int64_t slot, Take& take) const {
    constexpr int some = 64;
    std::uint32_t list[some];
    int listed = 0;
    auto add = [&](std::uint32_t begin, std::uint32_t end) {
      for (std::uint32_t other = begin; other < end; ++other) {
        if (other == slot) continue;
        list[listed++] = other;
        if (listed < some) continue;
        if (!take(list, some)) return false;
        listed = 0;
      }
      return true;
    };
    neighbors.visit_runs(pass.grid, slot, add);
    if (listed > 0 && listed < some) take(list, listed);
  }

  void finish(int member, const Members& members, const ContactBlock& block) const {
    const std::int64_t slot = members.first + member;
    const GridView& grid = pass.grid;
    typename Pass::Sum sum = pass.nothing_yet();
    if (!is_fixed(grid.mass_ids[slot].mass)) {
      const typename Pass::Side self = pass.side_at(slot);
      const int begin = member > 0 ? members.pairs_end[member - 1] : 0;
      for (int i = begin; i < members.pairs_end[member]; ++i) add(self, i, block, sum);
      pass.gather_walls(self, sum);
    }
    pass.finish(slot, sum);
  }

  // As GatherContacts::add_pair(); what does not count is 0.
  void add(const typename Pass::Side& self, int i, const ContactBlock& block, typename Pass::Sum& sum) const {
    sum.contacts += block.is_counted[i];
    sum.resting += block.is_resting[i];
    sum.out_of_range += block.out_of_range[i];
    fastcollide::add(sum.change, {block.change_x[i], block.change_y[i], block.change_z[i]});
    fastcollide::add(sum.crowd, {block.xx[i], block.yy[i], block.zz[i], block.xy[i], block.xz[i], block.yz[i]});
    if (block.is_impact[i] != 0) pass.keep_impact(block.others[i], block.met_at[i], sum);
    if (pass.grid.spins != nullptr && block.is_resting[i] != 0) {
      pass.rub(self, pass.side_at(block.others[i]), block.contact(i), block.push[i], block.speed[i], block.part[i],
               sum);
    }
  }
};

}  // namespace fastcollide
