// Threads that wait for slabs of work. The number of slabs belongs to the caller, never to the machine, and no result
// may depend on which thread runs a slab.
#pragma once

#include <functional>

namespace fastcollide {

// Runs work(0) ... work(slabs - 1) on the calling thread and up to threads - 1 others, and returns when all are done.
// When another thread of the program is using the pool, the caller runs all slabs by itself. Work must not throw.
void run_slabs(int threads, int slabs, const std::function<void(int)>& work);

// A forked child has none of its parent's threads: this lets it start its own. Called in the child, before any work.
void forget_threads_after_fork();

int hardware_threads();

}  // namespace fastcollide
