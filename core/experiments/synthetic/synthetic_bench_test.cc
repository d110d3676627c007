// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/synthetic/synthetic_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace evpose {
namespace {

using ::testing::HasSubstr;

std::vector<SyntheticBenchRow> RunBench(const SyntheticBenchOptions& options) {
  absl::StatusOr<std::vector<SyntheticBenchRow>> rows = RunSyntheticBench(options, nullptr, nullptr);
  EXPECT_TRUE(rows.ok()) << rows.status();
  return rows.ok() ? *std::move(rows) : std::vector<SyntheticBenchRow>();
}

SyntheticBenchOptions Few(SyntheticSweep sweep, const std::vector<std::string>& methods, int num_trials) {
  SyntheticBenchOptions options;
  options.sweeps = {sweep};
  options.methods = methods;
  options.num_trials = num_trials;
  return options;
}

TEST(SyntheticBenchTest, RowsAreInOrderAndAFunctionOfTheSeed) {
  SyntheticBenchOptions options = Few(SyntheticSweep::kNoise, {"ls", "m"}, 3);
  const std::vector<SyntheticBenchRow> rows = RunBench(options);
  ASSERT_EQ(rows.size(), 12u);
  EXPECT_EQ(rows[2].value, 2.0);
  EXPECT_EQ(rows[2].method, "ls");
  EXPECT_EQ(rows[3].method, "m");
  EXPECT_EQ(rows[3].num_trials, 3);
  EXPECT_EQ(rows[3].errors.rotation_median_deg, RunBench(options)[3].errors.rotation_median_deg);
  options.seed = 2;
  EXPECT_NE(rows[3].errors.rotation_median_deg, RunBench(options)[3].errors.rotation_median_deg);
}

TEST(SyntheticBenchTest, LeastSquaresAttainsTheBoundWithoutOutliers) {
  const std::vector<SyntheticBenchRow> rows = RunBench(Few(SyntheticSweep::kOutliers, {"ls"}, 60));
  ASSERT_EQ(rows.size(), 6u);
  EXPECT_EQ(rows[0].num_none, 0);
  // The noise is equal in both; the difference is due to curvature.
  EXPECT_NEAR(*rows[0].RotationRatio(), 1.0, 0.02);
  EXPECT_NEAR(*rows[0].TranslationRatio(), 1.0, 0.02);
  EXPECT_GT(*rows[5].RotationRatio(), 50.0) << "half of the events have wrong lines";
}

TEST(SyntheticBenchTest, WithoutNoiseThereIsNoRatio) {
  const std::vector<SyntheticBenchRow> rows = RunBench(Few(SyntheticSweep::kNoise, {"m"}, 3));
  EXPECT_FALSE(rows[0].bound.has_value());
  EXPECT_FALSE(rows[0].RotationRatio().has_value());
  EXPECT_FALSE(rows[0].TranslationRatio().has_value());
  EXPECT_LT(rows[0].errors.rotation_median_deg, 1e-5);
  EXPECT_TRUE(rows[1].RotationRatio().has_value());
}

TEST(SyntheticBenchTest, ErrorsGrowWithTheBound) {
  const std::vector<SyntheticBenchRow> rows = RunBench(Few(SyntheticSweep::kLines, {"mixture"}, 40));
  ASSERT_EQ(rows.size(), SyntheticSweepValues(SyntheticSweep::kLines).size());
  EXPECT_GT(rows.front().errors.rotation_median_deg, 3.0 * rows.back().errors.rotation_median_deg);
  EXPECT_GT(rows.front().bound->translation_median_ratio, 3.0 * rows.back().bound->translation_median_ratio);
}

TEST(SyntheticBenchTest, AFitWithoutAPoseCountsAsTheStart) {
  // Starts so far from the truth that lines are behind the camera.
  SyntheticBenchOptions options = Few(SyntheticSweep::kLines, {"ls"}, 20);
  options.start_factor = 100.0;
  int num_none = 0;
  for (const SyntheticBenchRow& row : RunBench(options)) {
    num_none += row.num_none;
    EXPECT_TRUE(std::isfinite(row.errors.rotation_mean_deg));
  }
  EXPECT_GT(num_none, 0);
}

TEST(SyntheticBenchTest, ProgressAndInterruption) {
  std::vector<double> ratios;
  int num_rows = 0;
  const SyntheticBenchOptions options = Few(SyntheticSweep::kNoise, {"ls"}, 2);
  const auto status = RunSyntheticBench(
                          options, [&](const SyntheticBenchRow&) { ++num_rows; },
                          [&](double ratio) {
                            ratios.push_back(ratio);
                            return ratios.size() < 7;
                          })
                          .status();
  EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(num_rows, 3);
  ASSERT_EQ(ratios.size(), 7u);
  EXPECT_NEAR(ratios.back(), 7.0 / 12.0, 1e-12);
}

TEST(SyntheticBenchTest, EveryMethodIsKnownByName) {
  for (const SyntheticMethod& method : SyntheticMethods()) {
    SyntheticBenchOptions options;
    options.methods = {method.name};
    EXPECT_TRUE(options.Validate().ok()) << method.name;
  }
  for (const SyntheticSweep sweep : SyntheticBenchOptions().sweeps) {
    EXPECT_EQ(*ParseSyntheticSweep(std::string(SyntheticSweepName(sweep))), sweep);
  }
  EXPECT_THAT(ParseSyntheticSweep("speed").status().message(), HasSubstr("noise, outliers, lines"));
}

TEST(SyntheticBenchTest, OptionsAreChecked) {
  const auto message = [](auto change) {
    SyntheticBenchOptions options;
    change(options);
    return std::string(options.Validate().message());
  };
  EXPECT_THAT(message([](auto& o) { o.num_trials = 0; }), HasSubstr("num_trials is 0"));
  EXPECT_THAT(message([](auto& o) { o.sweeps.clear(); }), HasSubstr("sweeps"));
  EXPECT_THAT(message([](auto& o) { o.start_factor = -1.0; }), HasSubstr("start_factor"));
  EXPECT_THAT(message([](auto& o) { o.methods = {"magic"}; }), HasSubstr("magic; known are: mixture, ls, m, s, mm"));
}

}  // namespace
}  // namespace evpose
