// SPDX-License-Identifier: Apache-2.0

// The events of a simulation, for tests.
#pragma once

#include <gtest/gtest.h>

#include <vector>

#include "core/simulation/simulator.h"

namespace evpose {

inline std::vector<Event> SimulatedEvents(const SimulationOptions& options, SimulationReport* report = nullptr) {
  std::vector<Event> events;
  const auto result = Simulate(options, [&](absl::Span<const Event> batch) {
    events.insert(events.end(), batch.begin(), batch.end());
    return absl::OkStatus();
  });
  EXPECT_TRUE(result.ok()) << result.status();
  if (report != nullptr && result.ok()) *report = *result;
  return events;
}

}  // namespace evpose
