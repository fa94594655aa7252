// A contact finder on one device, behind an interface that knows no backend.
#pragma once

#include <memory>

#include "fastcollide/contacts.hpp"

namespace fastcollide {

struct SearchInput {
  const SphereArrays& spheres;
  const SphereArrays* others;  // or null
  const SearchOptions& options;
};

class ContactEngine {
 public:
  virtual ~ContactEngine() = default;
  virtual std::int64_t count(const SearchInput& input) = 0;
  virtual ArrayView counts(const SearchInput& input) = 0;
  virtual ContactList contacts(const SearchInput& input, bool is_measured) = 0;
  virtual NeighborList neighbors(const SearchInput& input, const NeighborOptions& list) = 0;
  virtual std::int64_t reuses() const = 0;
};

// skin: of the candidates that are kept for later calls; 0 keeps none.
std::unique_ptr<ContactEngine> make_cpu_contact_engine(int threads, bool is_generic, double skin);
std::unique_ptr<ContactEngine> make_cuda_contact_engine(int device, double skin);

}  // namespace fastcollide
