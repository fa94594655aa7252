#include "thread_pool.hpp"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include "../float_environment.hpp"

namespace fastcollide {
namespace {

// A frame is some fifty short pieces of work in a row. A thread that has nothing to do asks again this many times
// before it sleeps, since to wake it takes longer than many a piece.
constexpr int patience = 300;

template <class Condition>
bool soon(const Condition& condition) {
  for (int i = 0; i < patience; ++i) {
    if (condition()) return true;
    std::this_thread::yield();
  }
  return false;
}

class ThreadPool {
 public:
  bool try_run(int threads, int slabs, const std::function<void(int)>& work) {
    const std::unique_lock turn(turn_, std::try_to_lock);
    if (!turn.owns_lock()) return false;
    while (static_cast<int>(threads_.size()) < threads - 1) {
      const int number = static_cast<int>(threads_.size()) + 1;
      threads_.emplace_back([this, number] { serve(number); });
    }
    {
      const std::lock_guard lock(mutex_);
      work_ = &work;
      users_ = threads;
      next_ = 0;
      slabs_ = slabs;
      unfinished_ = slabs;
      ++round_;
    }
    start_.notify_all();
    std::unique_lock lock(mutex_);
    take_slabs(lock);
    if (unfinished_ > 0) {
      lock.unlock();
      const bool is_done = soon([this] { return unfinished_ == 0; });
      lock.lock();
      if (!is_done) done_.wait(lock, [this] { return unfinished_ == 0; });
    }
    return true;
  }

 private:
  void serve(int number) {
    const DefaultFloatEnvironment environment;
    std::uint64_t seen = 0;
    for (;;) {
      const bool is_started = soon([&] { return round_ != seen; });
      std::unique_lock lock(mutex_);
      if (!is_started) start_.wait(lock, [&] { return round_ != seen; });
      seen = round_;
      if (number < users_) take_slabs(lock);
    }
  }

  // Which thread takes which slab is left to chance: a slow or busy one takes fewer.
  void take_slabs(std::unique_lock<std::mutex>& lock) {
    while (next_ < slabs_) {
      const int slab = next_++;
      const std::function<void(int)>& work = *work_;  // lives until unfinished_ is 0
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
  int users_ = 0, next_ = 0, slabs_ = 0;
  std::atomic<int> unfinished_ = 0;       // changed under the mutex, watched without it
  std::atomic<std::uint64_t> round_ = 0;  // likewise
};

ThreadPool*& thread_pool() {
  // Never destroyed: its threads serve to the end of the process, and at exit some systems end them before static
  // destructors run.
  static ThreadPool* pool = new ThreadPool;  // NOLINT(cppcoreguidelines-owning-memory)
  return pool;
}

}  // namespace

void run_slabs(int threads, int slabs, const std::function<void(int)>& work) {
  const DefaultFloatEnvironment environment;
  if (threads > 1 && slabs > 1 && thread_pool()->try_run(threads, slabs, work)) return;
  for (int slab = 0; slab < slabs; ++slab) work(slab);
}

void forget_threads_after_fork() { thread_pool() = new ThreadPool; }

int hardware_threads() { return std::max(1, static_cast<int>(std::thread::hardware_concurrency())); }

}  // namespace fastcollide
