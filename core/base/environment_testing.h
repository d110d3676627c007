// SPDX-License-Identifier: Apache-2.0

// Variables of the environment in tests.
#pragma once

#include <cstdlib>
#include <optional>
#include <string>
#include <utility>

namespace evpose {

// Sets a variable, and restores its former value at the end of its scope. No other thread may use the environment at
// these two times.
class ScopedEnvironmentVariable {
 public:
  ScopedEnvironmentVariable(std::string name, const std::string& value) : name_(std::move(name)) {
    if (const char* const former = std::getenv(name_.c_str())) former_ = former;
    Set(value);
  }
  ~ScopedEnvironmentVariable() { Set(former_); }
  ScopedEnvironmentVariable(const ScopedEnvironmentVariable&) = delete;
  ScopedEnvironmentVariable& operator=(const ScopedEnvironmentVariable&) = delete;

 private:
  void Set(const std::optional<std::string>& value) const {
    // NOLINTBEGIN(concurrency-mt-unsafe): see above
    if (value.has_value()) {
      setenv(name_.c_str(), value->c_str(), 1);
    } else {
      unsetenv(name_.c_str());
    }
    // NOLINTEND(concurrency-mt-unsafe)
  }

  const std::string name_;
  std::optional<std::string> former_;
};

}  // namespace evpose
