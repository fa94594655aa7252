// The engine, the renderer and the random start on CPU threads.
#include "backend/cpu.hpp"
#include "cpu/level_stages.hpp"
#include "cpu/listed_stages.hpp"
#include "engine.hpp"
#include "render/render_engine.hpp"

namespace fastcollide {

static_assert(Backend<CpuBackend>);

std::unique_ptr<Engine> make_cpu_engine(const WorldOptions& options, int threads) {
  return std::make_unique<EngineOn<CpuBackend>>(options, CpuBackend(threads));
}

std::unique_ptr<RendererEngine> make_cpu_renderer(int threads) {
  return std::make_unique<RenderEngineOn<CpuBackend>>(CpuBackend(threads));
}

Spheres cpu_random_spheres(const RandomSpheres& random) {
  CpuBackend backend(hardware_threads());
  return random_start(backend, random);
}

}  // namespace fastcollide
