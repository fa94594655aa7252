// Lists for worlds so small that every pair can be looked at when they are made. They hold until a sphere leaves its
// skin, over as many frames as that takes; then all are made anew before the next pass.
#pragma once

#include "advance.hpp"
#include "frame_lists.hpp"

namespace fastcollide {

// Of the spheres that a block owns: a row of places for each. A count may be larger than the places: then the list is
// void, and its sphere looks at all others.
struct SmallLists {
  std::uint32_t first;  // slot of the first of the spheres
  std::uint32_t places;
  std::uint16_t* entries;
  std::uint32_t* counts;
  Vec4* balls;  // of all slots: place, radius and skin when the lists were made

  FC_HOST_DEVICE std::uint16_t* of_slot(std::int64_t slot) const { return entries + (slot - first) * places; }
};

struct SmallNeighbors {
  SmallLists lists;

  // Calls visit(slot) for what a list holds, shared among the lanes.
  template <class Visit>
  FC_HOST_DEVICE void visit(const GridView& grid, std::int64_t slot, Vec3, Lane lane, Visit& visit) const {
    const std::uint32_t listed = lists.counts[slot - lists.first];
    const bool is_void = listed > lists.places;
    const auto all = is_void ? static_cast<std::uint32_t>(grid.count) : listed;
    const std::uint16_t* list = lists.of_slot(slot);
    for (auto i = static_cast<std::uint32_t>(lane.index); i < all; i += static_cast<std::uint32_t>(lane.count)) {
      const std::uint32_t other = is_void ? i : list[i];
      if (other != slot) visit(other);
    }
  }
};

// Before lists are made, for all slots.
struct BeginSmallLists {
  SlotState state;
  SkinLaw law;
  SmallLists lists;
  std::uint32_t owned;

  FC_HOST_DEVICE void operator()(std::int64_t slot) const {
    const Vec4 velocity = state.velocity_restitution[slot];
    Vec4 ball = state.position_radius[slot];
    ball.w = ball.w + law.skin_of({velocity.x, velocity.y, velocity.z});
    lists.balls[slot] = ball;
    if (slot < owned) lists.counts[slot] = 0;
  }
};

struct RecordSmallLists {
  const MassId* mass_ids;
  std::uint32_t count;
  Vec3 period;
  float reach;
  SmallLists lists;

  FC_HOST_DEVICE void assume_walls() { period = {0, 0, 0}; }
  FC_HOST_DEVICE void operator()(std::int64_t slot, Lane lane) const {
    if (is_fixed(mass_ids[slot].mass)) return;  // nothing pushes it, so it asks for nobody
    const Vec4 self = lists.balls[slot];
    std::uint16_t* list = lists.of_slot(slot);
    const auto lanes = static_cast<std::uint32_t>(lane.count);
    // Four at a time: they are loaded together.
    for (auto other = static_cast<std::uint32_t>(lane.index); other < count; other += 4 * lanes) {
      bool is_listed[4];
      FC_UNROLL
      for (std::uint32_t k = 0; k < 4; ++k) {
        const std::uint32_t here = other + k * lanes;
        is_listed[k] =
            here < count && here != slot && are_listed(self, lists.balls[here < count ? here : 0], period, reach);
      }
      FC_UNROLL
      for (std::uint32_t k = 0; k < 4; ++k) {
        if (!is_listed[k]) continue;
        const std::uint32_t place = atomic_add(lists.counts + (slot - lists.first), 1);
        if (place < lists.places) list[place] = static_cast<std::uint16_t>(other + k * lanes);
      }
    }
  }
};

// What a block tells the others after a pass: that a sphere of its own has left its skin, so that lists must be made
// anew.
struct alignas(16) SmallNews {
  std::uint32_t is_stale;
};

// Writes the last state of a pass to the other copy of the slots; where a frame begins after it, the reference solver
// flies.
struct ToSmallSlots {
  SlotState to;
  Vec3 period;
  const Vec4* balls;
  SmallNews* news;  // of this block, or null before there are lists
  AdvanceSphere advance;
  bool must_advance;

  FC_HOST_DEVICE void assume_walls() {
    period = {0, 0, 0};
    fastcollide::assume_walls(advance.box);
  }
  FC_HOST_DEVICE void write(std::int64_t slot, const Sphere& sphere, Vec3 position, Vec3 velocity, const Spin&) const {
    if (must_advance) advance(sphere.id, sphere.radius, sphere.mass, sphere.restitution, position, velocity);
    to.position_radius[slot] = {position.x, position.y, position.z, sphere.radius};
    to.velocity_restitution[slot] = {velocity.x, velocity.y, velocity.z, sphere.restitution};
    if (news != nullptr && is_out_of_skin(balls[slot], sphere.radius, position, period)) {
      atomic_max(&news->is_stale, 1);
    }
  }
  FC_HOST_DEVICE void write_crowding(std::int64_t slot, const Sphere&, float value) const { to.crowding[slot] = value; }
};

}  // namespace fastcollide
