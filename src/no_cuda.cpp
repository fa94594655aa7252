// Stands in for step_cuda.cu in a build without CUDA.
#include "engine.hpp"

namespace fastcollide {
namespace {

[[noreturn]] void refuse() { throw DeviceError("this build of FastCollide has no CUDA; use device=\"cpu\""); }

}  // namespace

std::unique_ptr<Engine> make_cuda_engine(const WorldOptions&, int) { refuse(); }
std::unique_ptr<RendererEngine> make_cuda_renderer(int) { refuse(); }
Spheres cuda_random_spheres(const RandomSpheres&, int) { refuse(); }
std::vector<Device> cuda_devices() { return {}; }
void cuda_copy_to_host(void*, const void*, std::size_t, int) { refuse(); }

}  // namespace fastcollide
