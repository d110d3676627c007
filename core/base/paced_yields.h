// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include "core/base/yield_point.h"

namespace evpose {

// The yield points of a loop in which each iteration takes a different number of steps: there is one after every
// `steps_between` steps, at the end of an iteration.
class PacedYields {
 public:
  explicit PacedYields(size_t steps_between) : steps_between_(steps_between) {}

  // To be called at the end of an iteration, with its number of steps.
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
