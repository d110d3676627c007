// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include "core/base/yield_point.h"

namespace evpose {

// Yield points of a loop whose bodies take different numbers of steps: one for each `steps_between` steps.
class PacedYields {
 public:
  explicit PacedYields(size_t steps_between) : steps_between_(steps_between) {}

  // After a body of so many steps.
  void Add(size_t steps) {
    steps_ += steps;
    if (steps_ < steps_between_) return;
    steps_ = 0;
    YieldPoint();
  }

 private:
  const size_t steps_between_;
  size_t steps_ = 0;
};

}  // namespace evpose
