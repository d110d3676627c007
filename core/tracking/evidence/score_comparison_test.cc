// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/score_comparison.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

namespace evpose {
namespace {

constexpr double kDispersion = 5.0;
constexpr double kExactModel = 0.0;

TEST(ScoreComparisonTest, EventsWithoutDifferencesDecideNothing) {
  ScoreComparison comparison;
  EXPECT_EQ(comparison.Sigma(kDispersion, kExactModel), 0.0);
  comparison.Add(0.0, 0.0, 100.0);
  EXPECT_EQ(comparison.Sigma(kDispersion, kExactModel), 0.0);
}

TEST(ScoreComparisonTest, IndependentEventsHaveTheVarianceOfCounts) {
  ScoreComparison comparison;
  for (int i = 0; i < 10; ++i) comparison.Add(20.0, 40.0, 100.0);
  EXPECT_NEAR(comparison.Sigma(kDispersion, kExactModel), 200.0 / std::sqrt(kDispersion * 400.0), 1e-12);
}

// More events in a window, with the same evidence for each of them, are no contradiction.
TEST(ScoreComparisonTest, WindowsMayDifferInTheirNumberOfEvents) {
  ScoreComparison comparison;
  for (int i = 1; i <= 10; ++i) comparison.Add(2.0 * i, 4.0 * i, 10.0 * i);
  EXPECT_NEAR(comparison.Sigma(kDispersion, kExactModel), 110.0 / std::sqrt(kDispersion * 220.0), 1e-12);
}

// The lamp's events of a window prefer one of the poses together, in the next window the other one.
TEST(ScoreComparisonTest, EventsThatDeviateTogetherAreNoEvidence) {
  constexpr int kRuns = 1000, kWindows = 30;
  std::mt19937_64 random(1);
  std::normal_distribution<double> of_window(0.0, 40.0);
  int decided = 0, decided_by_counts = 0;
  for (int run = 0; run < kRuns; ++run) {
    ScoreComparison comparison;
    double sum = 0.0;
    for (int i = 0; i < kWindows; ++i) {
      const double difference = of_window(random);
      comparison.Add(difference, 20.0, 100.0);
      sum += difference;
    }
    decided += std::abs(comparison.Sigma(kDispersion, kExactModel)) > 4.0;
    decided_by_counts += std::abs(sum) > 4.0 * std::sqrt(kDispersion * 20.0 * kWindows);
  }
  EXPECT_GT(decided_by_counts, kRuns / 4);
  EXPECT_LE(decided, 2);
}

// Two poses that differ in 1 % of what the events explain: an engraved number of a ring. An edge that is missing in the
// model outweighs it, however long it is seen.
TEST(ScoreComparisonTest, ASmallShareOfAllEventsIsNeverDecisive) {
  constexpr double kModelErrorRatio = 0.006;
  ScoreComparison small, large;
  for (int i = 0; i < 100'000; ++i) {
    small.Add(10.0, 20.0, 1000.0);
    large.Add(100.0, 200.0, 1000.0);
  }
  EXPECT_GT(small.Sigma(kDispersion, kExactModel), 100.0);
  EXPECT_NEAR(small.Sigma(kDispersion, kModelErrorRatio), 0.01 / kModelErrorRatio, 0.01);
  EXPECT_NEAR(large.Sigma(kDispersion, kModelErrorRatio), 0.1 / kModelErrorRatio, 0.1);
}

TEST(ScoreComparisonTest, ADamagedStateIsRefused) {
  ScoreComparison comparison;
  comparison.Add(20.0, 40.0, 100.0);
  StateWriter writer;
  writer(comparison);
  std::string bytes = writer.Take();
  ScoreComparison same;
  StateReader reader(bytes);
  reader(same);
  ASSERT_TRUE(reader.Finish().ok());
  EXPECT_EQ(same.Sigma(kDispersion, kExactModel), comparison.Sigma(kDispersion, kExactModel));
  bytes.back() = '\x80';  // the sign of the number of windows
  StateReader damaged(bytes);
  damaged(same);
  EXPECT_FALSE(damaged.Finish().ok());
}

}  // namespace
}  // namespace evpose
