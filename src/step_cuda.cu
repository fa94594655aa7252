// The engine, the renderer and the random start on CUDA.
#include "backend/cluster_run.cuh"
#include "backend/cuda.cuh"
#include "backend/graph_run.cuh"
#include "engine.hpp"
#include "render/render_engine.hpp"

namespace fastcollide {

static_assert(Backend<CudaBackend>);
extern template class LevelRuns<CudaBackend>;  // level_runs_cuda.cu
extern template class SmallRuns<CudaBackend>;  // small_runs_cuda.cu

std::unique_ptr<Engine> make_cuda_engine(const WorldOptions& options, int device) {
  return std::make_unique<EngineOn<CudaBackend>>(options, CudaBackend(device, options.block_size));
}

std::unique_ptr<RendererEngine> make_cuda_renderer(int device) {
  return std::make_unique<RenderEngineOn<CudaBackend>>(CudaBackend(device));
}

Spheres cuda_random_spheres(const RandomSpheres& random, int device) {
  CudaBackend backend(device);
  return random_start(backend, random);
}

void cuda_copy_to_host(void* host, const void* device, std::size_t bytes, int cuda_device) {
  const OnDevice on(cuda_device);
  check(cudaDeviceSynchronize(), "cuda");
  check(cudaMemcpy(host, device, bytes, cudaMemcpyDeviceToHost), "cudaMemcpy");
}

int device_of_cuda_memory(const void* address) {
  cudaPointerAttributes attributes{};
  check(cudaPointerGetAttributes(&attributes, address), "cudaPointerGetAttributes");
  if (attributes.type == cudaMemoryTypeDevice || attributes.type == cudaMemoryTypeManaged) return attributes.device;
  throw DeviceError("an array that calls itself one of CUDA does not lie in the memory of a CUDA device");
}

std::vector<Device> cuda_devices() {
  int count = 0;
  if (cudaGetDeviceCount(&count) != cudaSuccess) {
    cudaGetLastError();  // no driver, or a driver without a card: both mean none
    return {};
  }
  std::vector<Device> found;
  for (int device = 0; device < count; ++device) {
    cudaDeviceProp properties;
    check(cudaGetDeviceProperties(&properties, device), "cudaGetDeviceProperties");
    found.push_back({"cuda:" + std::to_string(device),
                     std::string(properties.name) + " (compute capability " + std::to_string(properties.major) + "." +
                         std::to_string(properties.minor) + ", " + std::to_string(properties.multiProcessorCount) +
                         " multiprocessors)",
                     static_cast<std::int64_t>(properties.totalGlobalMem)});
  }
  return found;
}

}  // namespace fastcollide
