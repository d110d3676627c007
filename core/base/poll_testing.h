// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <thread>

namespace evpose {

// Calls `condition`, with pauses of 1 ms, until it returns true. Returns false if it did not within `patience`, which
// is longer than any condition takes on a loaded machine under a sanitizer, so that a failure does not hang.
template <typename Condition>
[[nodiscard]] bool Poll(Condition condition, std::chrono::steady_clock::duration patience = std::chrono::minutes(4)) {
  const auto end = std::chrono::steady_clock::now() + patience;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace evpose
