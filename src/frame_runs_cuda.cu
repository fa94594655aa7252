// Frames with lists of their own on CUDA, compiled beside step_cuda.cu.
#include "backend/cuda.cuh"
#include "backend/graph_run.cuh"
#include "frame_runs.hpp"

namespace fastcollide {

template class FrameRuns<CudaBackend>;

}  // namespace fastcollide
