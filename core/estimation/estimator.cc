// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/estimator.h"

namespace evpose {

void DeficitCounts::Add(const DeficitCounts& window) {
  for (int half = 0; half < 2; ++half) {
    const double all = expected[half] + window.expected[half];
    const double keep = all > kMemoryEvents ? kMemoryEvents / all : 1.0;
    expected[half] = std::min(all, kMemoryEvents);
    observed[half] = std::clamp(keep * (observed[half] + window.observed[half]), -expected[half], expected[half]);
  }
}

}  // namespace evpose
