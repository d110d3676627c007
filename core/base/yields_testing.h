// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include "core/base/yield_point.h"

namespace evpose {

class CountsYields : public Yielder {
 public:
  void Yield() override { ++count; }

  size_t count = 0;
};

// Returns the number of yield points that `work` reaches.
size_t CountYields(auto&& work) {
  CountsYields yielder;
  const ScopedYielder scope(yielder);
  work();
  return yielder.count;
}

}  // namespace evpose
