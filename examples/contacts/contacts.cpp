// Which of these spheres touch? Finds all contacts of random spheres with FastCollide, and checks their number against
// a comparison of every pair.
#include "fastcollide/contacts.hpp"

#include <cstddef>
#include <cstdint>
#include <iostream>
#include <random>
#include <span>
#include <vector>

int main() {
  constexpr std::size_t count = 5000;
  std::mt19937 random(1);
  std::uniform_real_distribution<float> place(0.0f, 10.0f), size(0.05f, 0.4f);
  std::vector<float> positions(3 * count), radii(count);
  for (float& x : positions) x = place(random);
  for (float& r : radii) r = size(random);

  fastcollide::ContactFinder finder;
  fastcollide::SphereArrays spheres;
  spheres.positions = fastcollide::points(std::span<const float>(positions));
  spheres.radii = fastcollide::scalars(std::span<const float>(radii));
  const fastcollide::ContactList contacts = finder.contacts(spheres);

  const auto* first = static_cast<const std::int32_t*>(contacts.first.data);
  const auto* second = static_cast<const std::int32_t*>(contacts.second.data);
  const auto* gap = static_cast<const float*>(contacts.gap.data);
  std::cout << contacts.first.rows << " contacts; the first one: " << first[0] << " and " << second[0] << ", gap "
            << gap[0] << "\n";

  std::int64_t expected = 0;
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t j = i + 1; j < count; ++j) {
      double squared = 0;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const double offset = static_cast<double>(positions[3 * j + axis]) - positions[3 * i + axis];
        squared += offset * offset;
      }
      const double reach = static_cast<double>(radii[i]) + radii[j];
      expected += squared < reach * reach ? 1 : 0;
    }
  }
  if (contacts.first.rows != expected || finder.count(spheres) != expected) {
    std::cerr << "but every pair compared: " << expected << "\n";
    return 1;
  }

  // What lies within 0.5 of each centre, the nearest first, at most eight.
  fastcollide::SearchOptions within;
  within.margin = 0.5;
  within.is_inclusive = true;
  fastcollide::SphereArrays centers;
  centers.positions = spheres.positions;
  fastcollide::NeighborOptions nearest;
  nearest.sort_by_distance = true;
  nearest.most_neighbors = 8;
  const fastcollide::NeighborList neighbors = finder.neighbors(centers, within, nullptr, nearest);
  std::cout << neighbors.indices.rows << " neighbours; " << neighbors.shortened_rows << " centres have more\n";

  // The spheres move a little: a finder with a skin looks at the candidates that it has kept.
  fastcollide::ContactFinder following(0, 0.02);
  std::uniform_real_distribution<float> step(-0.001f, 0.001f);
  for (int frame = 0; frame < 5; ++frame) {
    for (float& x : positions) x += step(random);
    const fastcollide::ContactList followed = following.pairs(spheres);
    if (followed.first.rows != finder.count(spheres)) return 1;
  }
  std::cout << following.reuses() << " of 5 calls needed no new search\n";
  if (following.reuses() != 4) return 1;

  try {
    radii[17] = -1;
    finder.contacts(spheres);
  } catch (const fastcollide::InvalidValue& error) {
    std::cout << "refused: " << error.what() << "\n";
    return error.field() == "radii" && error.index() == 17 ? 0 : 1;
  }
  return 1;
}
