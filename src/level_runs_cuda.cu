// Frames by levels on CUDA, compiled beside step_cuda.cu.
#include "backend/cuda.cuh"
#include "level_runs.hpp"

namespace fastcollide {

template class LevelRuns<CudaBackend>;

}  // namespace fastcollide
