#include "thread_pool.hpp"

#include <algorithm>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include "../float_environment.hpp"

namespace fastcollide {
namespace {

class ThreadPool {
 public:
  ~ThreadPool() {
    {
      const std::lock_guard lock(mutex_);
      closing_ = true;
    }
    start_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }

  bool try_run(int slabs, const std::function<void(int)>& work) {
    const std::unique_lock turn(turn_, std::try_to_lock);
    if (!turn.owns_lock()) return false;
    while (static_cast<int>(threads_.size()) < slabs - 1) {
      const int slab = static_cast<int>(threads_.size()) + 1;
      threads_.emplace_back([this, slab, seen = round_] { serve(slab, seen); });
    }
    {
      const std::lock_guard lock(mutex_);
      work_ = &work;
      slabs_ = slabs;
      unfinished_ = slabs - 1;
      ++round_;
    }
    start_.notify_all();
    work(0);
    std::unique_lock lock(mutex_);
    done_.wait(lock, [this] { return unfinished_ == 0; });
    return true;
  }

 private:
  void serve(int slab, std::uint64_t seen) {
    const DefaultFloatEnvironment environment;
    std::unique_lock lock(mutex_);
    for (;;) {
      start_.wait(lock, [&] { return closing_ || round_ != seen; });
      if (closing_) return;
      seen = round_;
      if (slab >= slabs_) continue;
      const std::function<void(int)>& work = *work_;
      lock.unlock();
      work(slab);
      lock.lock();
      if (--unfinished_ == 0) done_.notify_one();
    }
  }

  std::mutex turn_;  // held by the one caller that is using the pool
  std::mutex mutex_;
  std::condition_variable start_, done_;
  std::vector<std::thread> threads_;
  const std::function<void(int)>* work_ = nullptr;
  int slabs_ = 0, unfinished_ = 0;
  std::uint64_t round_ = 0;
  bool closing_ = false;
};

ThreadPool*& thread_pool() {
  // Never destroyed: at exit the threads may already be gone (Windows ends them before static destructors run).
  static ThreadPool* pool = new ThreadPool;
  return pool;
}

}  // namespace

void run_slabs(int slabs, const std::function<void(int)>& work) {
  const DefaultFloatEnvironment environment;
  if (slabs > 1 && thread_pool()->try_run(slabs, work)) return;
  for (int slab = 0; slab < slabs; ++slab) work(slab);
}

void forget_threads_after_fork() { thread_pool() = new ThreadPool; }

int hardware_threads() { return std::max(1u, std::thread::hardware_concurrency()); }

}  // namespace fastcollide
