// Runs the report's scene through the public C++ interface and prints the hashes of its start, its end and a picture.
//   print_hash [particles [frames [device [threads [block_size [kind [cells | list | frame | levels | small]]]]]]]
// Kinds: reference; smooth and rough are the default solver without and with friction, rolling resistance and fixed
// spheres; packed is rough in a smaller box, in which most touch others; mixed is smooth, with most spheres 32 times
// smaller in a still smaller one.
#include <cinttypes>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <string>
#include <vector>

#include "fastcollide/renderer.hpp"
#include "fastcollide/world.hpp"

namespace {

// FNV-1a over the bytes of a small picture, coloured by radius.
std::uint64_t picture_hash(fastcollide::World& world) {
  fastcollide::Picture picture;
  picture.width = 320;
  picture.height = 180;
  picture.box_lower = world.options().lower;
  picture.box_upper = world.options().upper;
  const float edge = picture.box_upper[2];
  picture.eye = {1.0f * edge, -1.7f * edge, 1.1f * edge};
  picture.target = {0, 0, 0.4f * edge};
  picture.value_high = 0.4f;
  for (int i = 0; i < 768; ++i) picture.color_table[i] = static_cast<std::uint8_t>(i / 3 * (1 + i % 3));
  std::vector<std::uint8_t> rgb(static_cast<std::size_t>(3 * picture.width * picture.height));
  const fastcollide::ArrayView positions = world.positions(), radii = world.radii();
  fastcollide::Renderer(world.device())
      .draw(picture, world.count(), static_cast<const float*>(positions.data), static_cast<const float*>(radii.data),
            static_cast<const float*>(radii.data), radii.cuda_device, rgb.data());
  std::uint64_t hash = 0xCBF29CE484222325u;
  for (const std::uint8_t byte : rgb) hash = (hash ^ byte) * 0x100000001B3u;
  return hash;
}

}  // namespace

int main(int argc, char** argv) {
  const auto number = [&](int i, long otherwise) { return argc > i ? std::atol(argv[i]) : otherwise; };
  fastcollide::RandomSpheres random;
  random.count = number(1, 2000);
  // The cube grows with the count, at the density of 20,000 spheres in 20 m.
  for (float edge = 20; random.count > 20000LL * (edge / 20) * (edge / 20) * (edge / 20); edge *= 1.25f) {
    random.lower = {-edge * 0.625f, -edge * 0.625f, 0};
    random.upper = {edge * 0.625f, edge * 0.625f, edge * 1.25f};
  }
  const std::string kind = argc > 6 ? argv[6] : "rough";
  const bool is_rough = kind == "rough" || kind == "packed";
  for (auto* corner : {&random.lower, &random.upper}) {
    for (float& end : *corner) end *= kind == "mixed" ? 0.25f : kind == "packed" ? 0.45f : 1.0f;
  }
  fastcollide::WorldOptions options;
  options.lower = random.lower;
  options.upper = random.upper;
  options.device = argc > 3 ? argv[3] : "cpu";
  options.threads = static_cast<int>(number(4, 0));
  options.block_size = static_cast<int>(number(5, 128));
  const std::string method = argc > 7 ? argv[7] : "";
  if (method == "cells") options.method = fastcollide::Method::cells;
  if (method == "list") options.method = fastcollide::Method::list;
  if (method == "frame") options.method = fastcollide::Method::frame;
  if (method == "levels") options.method = fastcollide::Method::levels;
  if (method == "small") options.method = fastcollide::Method::small;
  try {
    options.solver = kind == "reference" ? fastcollide::Solver::reference : fastcollide::Solver::substep;
    options.wall_friction = is_rough ? 0.3f : 0.0f;
    options.rolling_friction = is_rough ? 0.05f : 0.0f;
    fastcollide::World world(options);
    fastcollide::Spheres spheres =
        fastcollide::random_spheres(random, options.device == "auto" ? "cpu" : options.device);
    if (is_rough) {
      spheres.friction.assign(spheres.radius.size(), 0.4f);
      for (std::size_t i = 0; i < spheres.mass.size(); i += 100) {
        spheres.mass[i] = std::numeric_limits<float>::infinity();
      }
    }
    for (std::size_t i = 0; kind == "mixed" && i < spheres.radius.size(); ++i) {
      if (i % 50 == 0) continue;
      spheres.radius[i] /= 32.0f;
      spheres.mass[i] /= 32.0f * 32.0f * 32.0f;
    }
    world.add(spheres);
    std::printf("start %016" PRIx64 "\n", world.state_hash());
    // Twice: what the first call has seen of the world may choose how the second one runs.
    const long frames = number(2, 60), half = frames / 2;
    world.step(half, 1.0 / 60);
    world.step(frames - half, 1.0 / 60);
    std::printf("picture %016" PRIx64 "\n", picture_hash(world));
    std::printf("end %016" PRIx64 " contacts %" PRId64 " overlap %.9g mean %.17g fast %" PRId64 " energy %.17g\n",
                world.state_hash(), world.contact_count(), static_cast<double>(world.max_overlap()),
                world.mean_overlap(), world.fast_flights().fast_spheres,
                world.energy().kinetic + world.energy().rotational + world.energy().potential);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "print_hash: %s\n", error.what());
    return 1;
  }
}
