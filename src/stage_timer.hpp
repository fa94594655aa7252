// Seconds spent in each stage. Off unless asked for: on a GPU the clock makes each stage wait for the one before.
#pragma once

#include <chrono>
#include <map>
#include <string>

namespace fastcollide {

class StageTimer {
 public:
  bool enabled = false;
  std::map<std::string, double> seconds;

  template <class B, class Stage>
  void time(B& backend, const char* name, Stage&& stage) {
    if (!enabled) return stage();
    backend.synchronize();
    const auto start = std::chrono::steady_clock::now();
    stage();
    backend.synchronize();
    seconds[name] += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }
};

}  // namespace fastcollide
