// Runs the report's scene through the public C++ interface and prints its state hash.
//   print_hash [particles [frames [device [threads [block_size]]]]]
#include <cinttypes>
#include <cstdio>
#include <cstdlib>

#include "fastcollide/world.hpp"

int main(int argc, char** argv) {
  const auto number = [&](int i, long otherwise) { return argc > i ? std::atol(argv[i]) : otherwise; };
  fastcollide::RandomSpheres random;
  random.count = number(1, 2000);
  // The cube grows with the count, at the density of 20,000 spheres in 20 m.
  for (float edge = 20; random.count > 20000LL * (edge / 20) * (edge / 20) * (edge / 20); edge *= 1.25f) {
    random.lower = {-edge * 0.625f, -edge * 0.625f, 0};
    random.upper = {edge * 0.625f, edge * 0.625f, edge * 1.25f};
  }
  fastcollide::WorldOptions options;
  options.lower = random.lower;
  options.upper = random.upper;
  options.device = argc > 3 ? argv[3] : "cpu";
  options.threads = static_cast<int>(number(4, 0));
  options.block_size = static_cast<int>(number(5, 128));
  try {
    fastcollide::World world(options);
    world.add(fastcollide::random_spheres(random, options.device == "auto" ? "cpu" : options.device));
    std::printf("start %016" PRIx64 "\n", world.state_hash());
    world.step(number(2, 60), 1.0 / 60);
    std::printf("end %016" PRIx64 " contacts %" PRId64 " overlap %.9g energy %.17g\n", world.state_hash(),
                world.contact_count(), static_cast<double>(world.max_overlap()),
                world.energy().kinetic + world.energy().potential);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "print_hash: %s\n", error.what());
    return 1;
  }
}
