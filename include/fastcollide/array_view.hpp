#pragma once

#include <cstdint>
#include <memory>

namespace fastcollide {

// Memory as seen from outside. It stays valid while `owner` is held.
struct ArrayView {
  void* data = nullptr;
  std::int64_t rows = 0;
  int columns = 0;       // 0: one-dimensional
  int cuda_device = -1;  // -1: host memory
  std::shared_ptr<void> owner;
};

}  // namespace fastcollide
