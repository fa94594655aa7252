#pragma once

#include <cfenv>

namespace fastcollide {

// The host program may have switched the rounding mode or flushed denormals to zero (some libraries do at import),
// which would change the bits: while one of these lives, its thread computes as the standard says.
class DefaultFloatEnvironment {
 public:
  DefaultFloatEnvironment() {
    std::fegetenv(&saved_);
    std::fesetenv(FE_DFL_ENV);
  }
  ~DefaultFloatEnvironment() { std::fesetenv(&saved_); }
  DefaultFloatEnvironment(const DefaultFloatEnvironment&) = delete;
  DefaultFloatEnvironment& operator=(const DefaultFloatEnvironment&) = delete;

 private:
  std::fenv_t saved_;
};

}  // namespace fastcollide
