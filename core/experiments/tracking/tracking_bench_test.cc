// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iterator>

#include "core/numerics/math.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

TrackingBenchOptions Short() {
  TrackingBenchOptions options;
  options.scenarios = {"constant-light"};
  options.estimators = {"mixture", "static-mm", "oracle"};
  options.num_seeds = 1;
  options.num_paths = 2;
  options.max_duration_us = 120'000;
  return options;
}

std::vector<TrackingBenchBlock> RunBench(const TrackingBenchOptions& options) {
  std::vector<TrackingBenchBlock> blocks;
  const absl::Status status =
      RunTrackingBench(options, [&](const TrackingBenchBlock& block) { blocks.push_back(block); });
  EXPECT_TRUE(status.ok()) << status;
  return blocks;
}

TEST(TrackingBenchTest, TheyFollowTheObject) {
  const std::vector<TrackingBenchBlock> blocks = RunBench(Short());
  ASSERT_EQ(blocks.size(), 1u);
  EXPECT_EQ(blocks[0].duration_us, 120'000);
  EXPECT_GT(blocks[0].mean_event_rate_hz, 1e5);
  ASSERT_EQ(blocks[0].rows.size(), 3u);
  for (const TrackingBenchRow& row : blocks[0].rows) {
    ASSERT_EQ(row.scores.size(), 2u);
    EXPECT_EQ(row.summary.overall.losses, 0u) << row.estimator;
    EXPECT_GT(row.summary.worst.coverage_ratio, 0.5) << row.estimator;
    EXPECT_LT(row.summary.overall.evaluation.position_rmse_of_depth, 0.02) << row.estimator;
    EXPECT_GT(row.summary.overall.compute_ratio, 0.0) << row.estimator;
    EXPECT_NE(row.scores[0].evaluation.position_rmse_m, row.scores[1].evaluation.position_rmse_m);
    EXPECT_FALSE(row.scores[0].errors.empty());
    EXPECT_TRUE(row.scores[1].errors.empty());
  }
  EXPECT_FALSE(blocks[0].rows[0].target_checks.empty());
  EXPECT_TRUE(blocks[0].rows[1].target_checks.empty());
}

TEST(TrackingBenchTest, TheOracleIsTheLowerBound) {
  const std::vector<TrackingBenchBlock> blocks = RunBench(Short());
  const TrackingBenchRow& mixture = blocks[0].rows[0];
  const TrackingBenchRow& oracle = blocks[0].rows[2];
  ASSERT_EQ(oracle.estimator, "oracle");
  EXPECT_EQ(oracle.summary.overall.losses, 0u);
  EXPECT_LT(kDegreesPerRadian * oracle.summary.overall.evaluation.rotation_p95_rad, 1.0);
  // Its windows equal those of the tracker, except before the first pose.
  EXPECT_GE(oracle.scores[0].errors.size(), mixture.scores[0].errors.size());
  EXPECT_GT(oracle.summary.worst.coverage_ratio, 0.95);
  // The estimate differs from the true start, and windows without events have no pose.
  EXPECT_GT(oracle.summary.overall.evaluation.position_median_m, 1e-5);
  for (const TrajectoryError& error : oracle.scores[0].errors) EXPECT_GT(error.position_m, 1e-9);
}

TEST(TrackingBenchTest, EveryEstimatorAndTheOracleHaveARow) {
  TrackingBenchOptions options = Short();
  options.estimators.clear();
  options.num_paths = 1;
  options.max_duration_us = 20'000;
  const std::vector<TrackingBenchBlock> blocks = RunBench(options);
  EXPECT_EQ(blocks[0].rows.size(), std::size(kEstimatorNames) + 1);
}

TEST(TrackingBenchTest, IsAFunctionOfItsOptions) {
  TrackingBenchOptions options = Short();
  options.num_paths = 1;
  options.estimators = {"mixture"};
  const TrackingScore first = RunBench(options)[0].rows[0].scores[0];
  const TrackingScore second = RunBench(options)[0].rows[0].scores[0];
  EXPECT_EQ(first.evaluation.position_rmse_m, second.evaluation.position_rmse_m);
  EXPECT_EQ(first.nees, second.nees);
}

TEST(TrackingBenchTest, StopsOnRequest) {
  double last = 0.0;
  const auto on_progress = [&](double ratio, const std::string& text) {
    EXPECT_GE(ratio, last);
    EXPECT_THAT(text, HasSubstr("constant-light, seed 1"));
    last = ratio;
    return false;
  };
  int blocks = 0;
  const absl::Status status = RunTrackingBench(
      Short(), [&](const TrackingBenchBlock&) { ++blocks; }, on_progress);
  EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(blocks, 0);
}

TEST(TrackingBenchTest, ErrorsNameTheArgument) {
  const auto message = [](const auto& change) {
    TrackingBenchOptions options;
    change(options);
    const absl::Status status = options.Validate();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    return std::string(status.message());
  };
  EXPECT_TRUE(TrackingBenchOptions().Validate().ok());
  EXPECT_THAT(message([](auto& o) { o.scenarios = {"teapot"}; }), HasSubstr("half-out"));
  EXPECT_THAT(message([](auto& o) { o.estimators = {"magic"}; }), HasSubstr("static-mm"));
  EXPECT_THAT(message([](auto& o) { o.num_seeds = 0; }), HasSubstr("num_seeds"));
  EXPECT_THAT(message([](auto& o) { o.num_paths = 0; }), HasSubstr("num_paths"));
  EXPECT_THAT(message([](auto& o) { o.max_duration_us = -1; }), HasSubstr("max_duration_us"));
  EXPECT_THAT(message([](auto& o) { o.tracker.windows.interval_us = 0; }), HasSubstr("interval_us"));
}

}  // namespace
}  // namespace evpose
