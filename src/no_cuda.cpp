// Stands in for step_cuda.cu in a build without CUDA.
#include "engine.hpp"
#include "search/engine_interface.hpp"

namespace fastcollide {
namespace {

[[noreturn]] void refuse() { throw DeviceError("this build of FastCollide has no CUDA; use device=\"cpu\""); }

}  // namespace

std::unique_ptr<Engine> make_cuda_engine(const WorldOptions&, int) { refuse(); }
std::unique_ptr<RendererEngine> make_cuda_renderer(int) { refuse(); }
std::unique_ptr<ContactEngine> make_cuda_contact_engine(int, double) { refuse(); }
Spheres cuda_random_spheres(const RandomSpheres&, int) { refuse(); }
std::vector<Device> cuda_devices() { return {}; }
void cuda_copy_to_host(void*, const void*, std::size_t, int) { refuse(); }
int device_of_cuda_memory(const void*) { refuse(); }

}  // namespace fastcollide
