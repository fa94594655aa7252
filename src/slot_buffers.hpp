// The memory of the slots that forms with lists keep.
#pragma once

#include "data.hpp"

namespace fastcollide {

template <Backend B>
struct SlotStateBuffers {
  explicit SlotStateBuffers(B& backend)
      : position_radius(backend), velocity_restitution(backend), crowding(backend), spins(backend) {}

  void resize(std::int64_t count, bool has_crowding, bool is_rough) {
    position_radius.resize(count);
    velocity_restitution.resize(count);
    crowding.resize(has_crowding ? count : 0);
    spins.resize(is_rough ? count : 0);
  }
  SlotState view() {
    return {position_radius.data(), velocity_restitution.data(), crowding.size() > 0 ? crowding.data() : nullptr,
            spins.size() > 0 ? spins.data() : nullptr};
  }

  typename B::template Buffer<Vec4> position_radius, velocity_restitution;
  typename B::template Buffer<float> crowding;
  typename B::template Buffer<Spin> spins;
};

}  // namespace fastcollide
