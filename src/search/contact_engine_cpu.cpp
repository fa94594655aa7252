// The contact finder on CPU threads, in its fast form and in the one that a GPU runs.
#include "contact_engine.hpp"
#include "cpu_searcher.hpp"
#include "generic_searcher.hpp"

namespace fastcollide {
namespace {

template <class T>
using GenericOnCpu = search::GenericSearcher<CpuBackend, T>;

}  // namespace

std::unique_ptr<ContactEngine> make_cpu_contact_engine(int threads, bool is_generic, double skin) {
  if (is_generic) return std::make_unique<search::ContactEngineOn<CpuBackend, GenericOnCpu>>(CpuBackend(threads), skin);
  return std::make_unique<search::ContactEngineOn<CpuBackend, search::CpuSearcher>>(CpuBackend(threads), skin);
}

}  // namespace fastcollide
