// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/estimator.h"

namespace evpose {

void LineAnswer::Add(const LineAnswer& window) {
  for (int half = 0; half < 2; ++half) {
    const double all = expected[half] + window.expected[half];
    const double keep = all > kEnough ? kEnough / all : 1.0;
    expected[half] = std::min(all, kEnough);
    observed[half] = std::clamp(keep * (observed[half] + window.observed[half]), -expected[half], expected[half]);
  }
}

}  // namespace evpose
