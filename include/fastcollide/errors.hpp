// Every error that FastCollide raises for its user.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

namespace fastcollide {

// A value outside its range. `field` is the name of the argument; `index` its element, or -1 for a scalar.
class InvalidValue : public std::invalid_argument {
 public:
  InvalidValue(const std::string& field, std::int64_t index, const std::string& found, const std::string& allowed)
      : std::invalid_argument(message(field, index, found, allowed)), field_(field), index_(index) {}

  const std::string& field() const { return field_; }
  std::int64_t index() const { return index_; }

 private:
  static std::string message(const std::string& field, std::int64_t index, const std::string& found,
                             const std::string& allowed) {
    std::string text = field;
    if (index >= 0) text.append("[").append(std::to_string(index)).append("]");
    return text.append(": found ").append(found).append("; allowed: ").append(allowed);
  }

  std::string field_;
  std::int64_t index_;
};

// The device that was asked for is not there, or it failed.
class DeviceError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// The simulation left the range in which it is exact: a sphere too fast, too many contacts, not a number.
class SimulationError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// The device or the host has less memory than asked for.
class OutOfMemory : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace fastcollide
