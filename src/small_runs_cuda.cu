// Small worlds on CUDA, compiled beside step_cuda.cu.
#include "backend/cluster_run.cuh"
#include "small_runs.hpp"

namespace fastcollide {

template class SmallRuns<CudaBackend>;

}  // namespace fastcollide
