// SPDX-License-Identifier: Apache-2.0

// Variables of the environment in tests.
#pragma once

#include <cstdlib>
#include <string>
#include <utility>

namespace evpose {

// Sets a variable that was not set before, and removes it at the end of its scope. No other thread may use the
// environment at these two times.
class ScopedEnvironmentVariable {
 public:
  ScopedEnvironmentVariable(std::string name, const std::string& value) : name_(std::move(name)) {
    setenv(name_.c_str(), value.c_str(), 1);  // NOLINT(concurrency-mt-unsafe): see above
  }
  ~ScopedEnvironmentVariable() {
    unsetenv(name_.c_str());  // NOLINT(concurrency-mt-unsafe): see above
  }
  ScopedEnvironmentVariable(const ScopedEnvironmentVariable&) = delete;
  ScopedEnvironmentVariable& operator=(const ScopedEnvironmentVariable&) = delete;

 private:
  const std::string name_;
};

}  // namespace evpose
