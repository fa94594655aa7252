// Seconds spent in each stage. Off unless asked for: the clock makes each stage wait for the one before.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <map>
#include <string>

namespace fastcollide {

enum class Stage : std::uint8_t {
  load,
  advance,
  build_grid,
  make_lists,
  solve_contacts,
  gather_contacts,
  apply_contacts,
  store
};

inline constexpr std::array stage_names{"load",           "advance",         "build_grid",     "make_lists",
                                        "solve_contacts", "gather_contacts", "apply_contacts", "store"};

class StageTimer {
 public:
  bool enabled = false;

  template <class B, class Work>
  void time(B& backend, Stage stage, Work&& work) {
    if (!enabled) return work();
    backend.synchronize();
    const auto start = std::chrono::steady_clock::now();
    work();
    backend.synchronize();
    add(stage, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  void add(Stage stage, double seconds) { seconds_[static_cast<std::size_t>(stage)] += seconds; }

  // Of the stages that ran.
  std::map<std::string, double> seconds() const {
    std::map<std::string, double> named;
    for (std::size_t i = 0; i < seconds_.size(); ++i) {
      if (seconds_[i] > 0) named[stage_names[i]] = seconds_[i];
    }
    return named;
  }

 private:
  std::array<double, stage_names.size()> seconds_{};
};

}  // namespace fastcollide
