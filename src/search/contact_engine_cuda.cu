// The contact finder on CUDA.
#include "../backend/cuda.cuh"
#include "contact_engine.hpp"
#include "generic_searcher.hpp"

namespace fastcollide {
namespace {

template <class T>
using GenericOnCuda = search::GenericSearcher<CudaBackend, T>;

}  // namespace

std::unique_ptr<ContactEngine> make_cuda_contact_engine(int device, double skin) {
  return std::make_unique<search::ContactEngineOn<CudaBackend, GenericOnCuda>>(CudaBackend(device), skin);
}

}  // namespace fastcollide
