// SPDX-License-Identifier: Apache-2.0

// The progress of evpose bench speed.
#include <gtest/gtest.h>

#include <algorithm>
#include <sstream>
#include <string>
#include <vector>

#include "client/bench/service_bench.h"
#include "core/experiments/speed/speed_bench.h"

namespace evpose::client {
namespace {

// Expects shares of the work that begin in the first step, do not decrease, and end in the last of `num_steps` steps.
void ExpectProgress(const std::vector<double>& ratios, double num_steps) {
  ASSERT_FALSE(ratios.empty());
  EXPECT_LT(ratios.front(), 1.0 / num_steps);
  EXPECT_TRUE(std::is_sorted(ratios.begin(), ratios.end()));
  EXPECT_GE(ratios.back(), 1.0 - 1.0 / num_steps);
  EXPECT_LE(ratios.back(), 1.0);
}

TEST(BenchProgressTest, SpeedCountsTheScenesThatItMeasures) {
  std::vector<double> ratios;
  const SpeedProgress on_progress = [&](double ratio, const std::string&) {
    ratios.push_back(ratio);
    return true;
  };
  const absl::Status status = RunSpeedBench(
      {.parts = {"decode"}, .duration_us = 10'000, .num_repetitions = 1}, [](const SpeedRow&) {}, on_progress);
  ASSERT_TRUE(status.ok()) << status;
  ExpectProgress(ratios, 4.0);  // two scenes, simulated and decoded
}

TEST(BenchProgressTest, OnePartThroughAServerProceedsWithItsRepetitions) {
  std::vector<double> ratios;
  const SpeedProgress on_progress = [&](double ratio, const std::string&) {
    ratios.push_back(ratio);
    return true;
  };
  std::ostringstream out, err;
  CliContext context{out, err};
  ServiceBenchOptions options;
  options.parts = {"transport"};
  options.duration_us = 10'000;
  options.num_repetitions = 4;
  const absl::Status status = RunServiceBench(
      options, context, [](const ServiceRow&) {}, on_progress);
  ASSERT_TRUE(status.ok()) << status;
  ExpectProgress(ratios, 2.0);  // the simulation and the measurement
  EXPECT_DOUBLE_EQ(ratios.back(), 0.5 + 0.5 * 3 / 4) << "before the last repetition";
}

}  // namespace
}  // namespace evpose::client
