#include "../backend/cpu.hpp"
#include "contact_engine.hpp"
#include "generic_searcher.hpp"

namespace fastcollide {
namespace {

template <class T>
using GenericOnCpu = search::GenericSearcher<CpuBackend, T>;

}  // namespace

std::unique_ptr<ContactEngine> make_cpu_contact_engine(int threads, bool) {
  return std::make_unique<search::ContactEngineOn<CpuBackend, GenericOnCpu>>(CpuBackend(threads));
}

}  // namespace fastcollide
