// The contact pass on a CPU: the near ones of several spheres are collected first, then all their contacts are worked
// on side by side, then each sphere adds up its own. The sums are those of GatherContacts::gather().
#pragma once

#include <algorithm>

#include "../stages/gather_contacts.hpp"
#include "../stages/neighbor_lists.hpp"
#include "contact_block.hpp"

namespace fastcollide {

template <class Output>
struct GatherBlocks {
  using Pass = GatherContacts<ListedNeighbors, Output>;

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

  // False where the block has too little room for all in the list.
  bool collect(std::int64_t slot, Members& members, ContactBlock& block) const {
    constexpr std::int64_t far_ahead = 12;  // as lists lie apart, the processor does not see which comes next
    const GridView& grid = pass.grid;
    const NeighborLists& lists = pass.neighbors.lists;
    if (!is_fixed(grid.mass_ids[slot].mass)) {
      const auto listed = static_cast<std::int64_t>(lists.counts[slot].pending);
      if (listed > ContactBlock::size - members.pairs) return false;
      search::fetch_ahead(lists.of_row(std::min(slot + far_ahead, grid.count - 1)));
      pass.neighbors.publish(slot);
      members.pairs = functions.collect(grid, pass.substep.law.opening_margin, slot, lists.of_row(slot),
                                        static_cast<int>(listed), members.pairs, block);
    }
    members.pairs_end[members.count++] = members.pairs;
    return true;
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
