// Runs the page of a small world with one copy of all spheres.
#pragma once

#include "host_run.hpp"
#include "small_step.hpp"

namespace fastcollide {

// Stages one after the other on a backend, with one copy of all spheres.
template <Backend B>
class SmallHostRun {
 public:
  SmallHostRun(B& backend, StageTimer& timer, std::int64_t count) : run_(backend, timer), count_(count) {}

  static std::uint32_t first() { return 0; }
  std::uint32_t owned() const { return static_cast<std::uint32_t>(count_); }
  static std::uint32_t block() { return 0; }
  static std::uint32_t blocks() { return 1; }
  template <class F>
  void for_all(Stage stage, std::int64_t n, const F& f) {
    run_.for_each(stage, n, f);
  }
  template <class F>
  void for_own(Stage stage, const F& f) {
    run_.for_each(stage, count_, f);
  }
  template <class F>
  void for_own_shared(Stage stage, const F& f) {
    run_.for_each(stage, count_, [&](std::int64_t slot) { f(slot, Lane{}); });
  }
  template <class F, class Send>
  void for_each(Stage stage, const F& f, const Send&) {
    run_.for_each(stage, count_, f);
  }
  template <class Pass, class Send>
  void for_each_sphere(Stage stage, const Pass& pass, const Send&) {
    run_.for_each_sphere(stage, count_, pass);
  }
  template <class F>
  void alone(const F& f) {
    f();
  }
  static bool any_is_stale(const SmallNews* news) { return news->is_stale != 0; }
  static void wait_for_memory() {}
  static std::uint64_t read(const std::uint64_t* word) { return *word; }

 private:
  HostRun<B> run_;
  std::int64_t count_;
};

// What runs the page of small worlds on a backend, and how much room a block has; backend/cluster_run.cuh has that of
// CUDA.
template <Backend B>
struct SmallRunner {
  explicit SmallRunner(B& backend) : backend(backend) {}

  // Beyond, to look at all pairs would take longer than to sort.
  static constexpr std::int64_t most_spheres = 4096;
  bool has_room(const SmallWorld& world) const { return world.count <= most_spheres; }
  // Whether it is the fastest form.
  bool pays(std::int64_t) const { return false; }

  template <class Program>
  void run(const Program& program, StageTimer& timer) {
    SmallWorld measured = program.world;
    memory.resize(static_cast<std::int64_t>(measured.lay_out(nullptr, measured.count, 1)) / 16);
    SmallHostRun<B> stages(backend, timer, measured.count);
    program(stages, reinterpret_cast<unsigned char*>(memory.data()), measured.count);
  }

  B& backend;
  typename B::template Buffer<Vec4> memory{backend};
};

}  // namespace fastcollide
