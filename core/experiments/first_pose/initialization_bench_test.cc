// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/initialization_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "core/base/find_named.h"
#include "core/experiments/first_pose/initialization_methods.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

InitializationBenchOptions Small() {
  InitializationBenchOptions options;
  options.num_trials = 5;
  options.objects = {SimulatedObject::kCube};
  options.clutter = {{0, 0}};
  return options;
}

TEST(InitializationBench, EveryMethodHasItsRow) {
  InitializationBenchOptions options = Small();
  options.clutter = {{0, 0}, {2, 1}};
  int seen = 0;
  const auto rows = RunInitializationBench(options, [&](const InitializationBenchRow&) { return ++seen > 0; });
  ASSERT_TRUE(rows.ok()) << rows.status();
  const size_t num_methods = InitializationMethods().size();
  ASSERT_EQ(rows->size(), 2 * num_methods);
  EXPECT_EQ(seen, static_cast<int>(rows->size()));
  std::set<std::string> names;
  for (const InitializationBenchRow& row : *rows) {
    names.insert(row.method);
    EXPECT_EQ(row.num_trials, 5);
    EXPECT_LE(row.num_right + row.num_none, 5);
    EXPECT_LE(row.median_ms, row.worst_ms);
    EXPECT_GT(row.median_ms, 0.0);
    if (row.num_right == 5) {
      EXPECT_NEAR(row.reprojection_mean_px, row.reprojection_mean_right_px, 1e-9);
    }
  }
  EXPECT_EQ(names.size(), num_methods);
}

TEST(InitializationBench, ASeedDeterminesTheTableExceptForTimes) {
  const auto a = RunInitializationBench(Small(), nullptr);
  const auto b = RunInitializationBench(Small(), nullptr);
  ASSERT_TRUE(a.ok() && b.ok());
  for (size_t i = 0; i < a->size(); ++i) {
    EXPECT_EQ((*a)[i].num_right, (*b)[i].num_right);
    EXPECT_EQ((*a)[i].reprojection_mean_px, (*b)[i].reprojection_mean_px);
    EXPECT_EQ((*a)[i].reprojection_median_px, (*b)[i].reprojection_median_px);
  }
}

TEST(InitializationBench, KnownCorrespondencesAreRight) {
  InitializationBenchOptions options = Small();
  options.methods = {"sqpnp", "aspnl"};
  options.clutter = {{4, 2}};
  options.num_trials = 20;
  const auto rows = RunInitializationBench(options, nullptr);
  ASSERT_TRUE(rows.ok()) << rows.status();
  for (const InitializationBenchRow& row : *rows) {
    EXPECT_GE(row.num_right, 19) << row.method;
    EXPECT_LT(row.reprojection_mean_right_px, 1.5);
  }
}

TEST(InitializationBench, SlowMethodsDoFewerTrialsUnlessAskedTo) {
  InitializationBenchOptions options = Small();
  options.methods = {"sqpnp", "softposit"};
  options.objects = {SimulatedObject::kPlanar};  // softposit rejects planar models at once
  const int limit = FindNamed(InitializationMethods(), "softposit", "$0")->max_trials;
  options.num_trials = limit + 10;
  auto rows = RunInitializationBench(options, nullptr);
  ASSERT_TRUE(rows.ok());
  EXPECT_EQ((*rows)[0].num_trials, limit + 10);
  EXPECT_EQ((*rows)[1].num_trials, limit);
  EXPECT_EQ((*rows)[1].num_none, limit);
  EXPECT_TRUE(std::isnan((*rows)[1].reprojection_mean_right_px));
  options.is_unlimited = true;
  rows = RunInitializationBench(options, nullptr);
  EXPECT_EQ((*rows)[1].num_trials, limit + 10);
}

TEST(InitializationBench, CertifiesFoundPoses) {
  InitializationBenchOptions options = Small();
  options.num_trials = 20;
  options.noise_px = 0.0;  // the true rotation then explains every line
  options.methods = {"sqpnp", "published-bnb", "evpose"};
  options.certifies = true;
  auto rows = RunInitializationBench(options, nullptr);
  ASSERT_TRUE(rows.ok()) << rows.status();
  EXPECT_FALSE((*rows)[0].certificates) << "the correspondences were given";
  ASSERT_TRUE((*rows)[1].certificates && (*rows)[2].certificates);
  const CertificateCounts& ours = *(*rows)[2].certificates;
  EXPECT_EQ((*rows)[2].num_right, 20);
  EXPECT_TRUE((*rows)[2].failed_seeds.empty());
  EXPECT_EQ(ours.num_maximum, 20);
  EXPECT_GT(ours.median_ms, 0.0);

  options.methods = {"evpose"};
  options.clutter = {{4, 2}};  // not every line can be explained, and the search takes more than one cube
  options.certificate.max_branches = 1;
  rows = RunInitializationBench(options, nullptr);
  ASSERT_TRUE(rows.ok()) << rows.status();
  const CertificateCounts& poor = *(*rows)[0].certificates;
  EXPECT_EQ(poor.num_maximum + poor.num_not_maximum + poor.num_unknown, 20);
  EXPECT_GT(poor.num_unknown, 0);

  options.certifies = false;
  rows = RunInitializationBench(options, nullptr);
  ASSERT_TRUE(rows.ok());
  EXPECT_FALSE((*rows)[0].certificates);
}

TEST(InitializationBench, FailedSeedsAreThoseOfTheFailedTrials) {
  InitializationBenchOptions options = Small();
  options.methods = {"ransac"};
  options.clutter = {{4, 2}};
  options.num_trials = 10;
  const auto rows = RunInitializationBench(options, nullptr);
  ASSERT_TRUE(rows.ok());
  EXPECT_EQ(static_cast<int>((*rows)[0].failed_seeds.size()), 10 - (*rows)[0].num_right);
}

TEST(InitializationBench, StopsOnRequestOfTheCaller) {
  const auto rows = RunInitializationBench(Small(), [](const InitializationBenchRow&) { return false; });
  EXPECT_EQ(rows.status().code(), absl::StatusCode::kCancelled);
}

TEST(InitializationBench, OptionsAreChecked) {
  const auto message = [](const InitializationBenchOptions& options) {
    const auto rows = RunInitializationBench(options, nullptr);
    EXPECT_EQ(rows.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(rows.status().message());
  };
  InitializationBenchOptions options = Small();
  options.methods = {"magic"};
  EXPECT_THAT(message(options), HasSubstr("\"magic\""));
  EXPECT_THAT(message(options), HasSubstr("sqpnp, aspnl, ropnl, softposit, blind-pnp, ransac, published-bnb, evpose"));
  options = Small();
  options.num_trials = 0;
  EXPECT_THAT(message(options), HasSubstr("num_trials"));
  options = Small();
  options.clutter = {{-1, 0}};
  EXPECT_THAT(message(options), HasSubstr("num_spurious"));
}

}  // namespace
}  // namespace evpose
