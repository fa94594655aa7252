// Choice of the device, checks of what belongs together, turns.
#include <cmath>
#include <map>
#include <mutex>

#include "device_choice.hpp"
#include "float_environment.hpp"
#include "search/engine_interface.hpp"
#include "text.hpp"
#include "validation.hpp"

namespace fastcollide {
namespace {

constexpr std::int64_t most_rows = (std::int64_t(1) << 31) - 64;  // indices are int32

std::string place_of(int cuda_device) { return cuda_device < 0 ? "the host" : "cuda:" + std::to_string(cuda_device); }

void check_together(const ConstArray& array, const ConstArray& model, const char* field) {
  if (array.is_double != model.is_double) {
    throw InvalidValue(field, -1, array.is_double ? "float64" : "float32",
                       std::string(model.is_double ? "float64" : "float32") + ", the type of positions");
  }
  if (array.cuda_device != model.cuda_device) {
    throw InvalidValue(field, -1, "an array on " + place_of(array.cuda_device),
                       "one on " + place_of(model.cuda_device) + ", like positions");
  }
}

void check_set(const SphereArrays& spheres, const ConstArray& model, const char* positions, const char* radii) {
  check_together(spheres.positions, model, positions);
  if (spheres.positions.rows > most_rows) {
    throw InvalidValue(positions, -1, std::to_string(spheres.positions.rows) + " rows",
                       "at most " + std::to_string(most_rows));
  }
  if (spheres.radii.data == nullptr) {
    require(between(spheres.radius, 0, 1e300), radii, spheres.radius, "a finite number, 0 or more");
    return;
  }
  check_together(spheres.radii, model, radii);
  if (spheres.radii.rows != spheres.positions.rows) {
    throw InvalidValue(radii, -1, std::to_string(spheres.radii.rows) + " numbers",
                       std::to_string(spheres.positions.rows) + ", one for each of " + positions);
  }
}

void check_input(const SearchInput& input) {
  const SearchOptions& options = input.options;
  check_set(input.spheres, input.spheres.positions, "positions", "radii");
  if (input.others != nullptr) check_set(*input.others, input.spheres.positions, "other_positions", "other_radii");
  require(between(options.margin, 0, 1e300), "margin", options.margin, "a finite number, 0 or more");
  for (int axis = 0; axis < 3; ++axis) {
    if (options.boundary[axis] != Boundary::periodic) continue;
    require(std::isfinite(options.lower[axis]), "bounds", options.lower[axis], "finite numbers", axis);
    require(std::isfinite(options.upper[axis]) && options.upper[axis] > options.lower[axis], "bounds",
            options.upper[axis], "a finite number above the lower end, " + text_of(options.lower[axis]), axis);
  }
}

}  // namespace

class ContactEngines {
 public:
  ContactEngines(int threads, double skin) : threads_(choose_threads(threads)), skin_(skin) {
    require(between(skin, 0, 1e300), "skin", skin, "a finite number, 0 or more");
  }

  // search(engine) with the engine of the device that holds the arrays.
  template <class Search>
  auto with_engine(const SearchInput& input, const Search& search) {
    const DefaultFloatEnvironment environment;
    check_input(input);
    const std::lock_guard lock(mutex_);
    const int device = input.spheres.positions.cuda_device;
    std::unique_ptr<ContactEngine>& engine = engines_[device];
    if (!engine) {
      engine =
          device < 0 ? make_cpu_contact_engine(threads_, is_generic_, skin_) : make_cuda_contact_engine(device, skin_);
    }
    return search(*engine);
  }

  void use_generic_form(bool is_generic) {
    const std::lock_guard lock(mutex_);
    is_generic_ = is_generic;
    engines_.erase(-1);
  }

  std::int64_t reuses() {
    const std::lock_guard lock(mutex_);
    std::int64_t reuses = 0;
    for (const auto& [device, engine] : engines_) reuses += engine ? engine->reuses() : 0;
    return reuses;
  }

 private:
  int threads_;
  double skin_;
  bool is_generic_ = false;
  std::mutex mutex_;
  std::map<int, std::unique_ptr<ContactEngine>> engines_;
};

ContactFinder::ContactFinder(int threads, double skin) : engines_(std::make_unique<ContactEngines>(threads, skin)) {}
ContactFinder::~ContactFinder() = default;
ContactFinder::ContactFinder(ContactFinder&&) noexcept = default;
ContactFinder& ContactFinder::operator=(ContactFinder&&) noexcept = default;

std::int64_t ContactFinder::reuses() const { return engines_->reuses(); }

void ContactFinder::use_generic_form(bool is_generic) { engines_->use_generic_form(is_generic); }

std::int64_t ContactFinder::count(const SphereArrays& spheres, const SearchOptions& options,
                                  const SphereArrays* others) {
  const SearchInput input{spheres, others, options};
  return engines_->with_engine(input, [&](ContactEngine& engine) { return engine.count(input); });
}

ArrayView ContactFinder::counts(const SphereArrays& spheres, const SearchOptions& options, const SphereArrays* others) {
  const SearchInput input{spheres, others, options};
  return engines_->with_engine(input, [&](ContactEngine& engine) { return engine.counts(input); });
}

ContactList ContactFinder::pairs(const SphereArrays& spheres, const SearchOptions& options,
                                 const SphereArrays* others) {
  const SearchInput input{spheres, others, options};
  return engines_->with_engine(input, [&](ContactEngine& engine) { return engine.contacts(input, false); });
}

ContactList ContactFinder::contacts(const SphereArrays& spheres, const SearchOptions& options,
                                    const SphereArrays* others) {
  const SearchInput input{spheres, others, options};
  return engines_->with_engine(input, [&](ContactEngine& engine) { return engine.contacts(input, true); });
}

NeighborList ContactFinder::neighbors(const SphereArrays& spheres, const SearchOptions& options,
                                      const SphereArrays* others, const NeighborOptions& list) {
  const SearchInput input{spheres, others, options};
  if (list.most_neighbors < 0) {
    throw InvalidValue("max_neighbors", -1, std::to_string(list.most_neighbors), "0 or more");
  }
  return engines_->with_engine(input, [&](ContactEngine& engine) { return engine.neighbors(input, list); });
}

}  // namespace fastcollide
