// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/statistics.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace evpose {
namespace {

using Values = std::vector<double>;

Values Sorted(Values values) {
  std::sort(values.begin(), values.end());
  return values;
}

TEST(StatisticsTest, SelectNthIsTheNthOfTheSortedValues) {
  const Values values = {5.0, 1.0, 4.0, 1.0, 3.0, 9.0, 2.0};
  for (size_t n = 0; n < values.size(); ++n) {
    Values copy = values;
    EXPECT_EQ(SelectNth(copy, n), Sorted(values)[n]);
    EXPECT_EQ(Sorted(copy), Sorted(values));
  }
}

TEST(StatisticsTest, MediansOfAnEvenNumberOfValues) {
  const Values values = {4.0, 2.0, 3.0, 1.0};
  Values copy = values;
  EXPECT_EQ(UpperMedian(copy), 3.0);
  copy = values;
  EXPECT_EQ(UpperQuantile(copy, 0.5), 3.0);
  EXPECT_EQ(NearestQuantile(Sorted(values), 0.5), 3.0);
  EXPECT_EQ(InterpolatedQuantile(Sorted(values), 0.5), 2.5);
}

TEST(StatisticsTest, AMedianOfNoValuesIsTheGivenOne) {
  EXPECT_EQ(UpperMedianOr(Values(), -1.0), -1.0);
  EXPECT_EQ(UpperMedianOr(Values{4.0, 2.0, 3.0, 1.0}, -1.0), 3.0);
}

TEST(StatisticsTest, MediansOfAnOddNumberOfValuesAgree) {
  const Values values = {4.0, 2.0, 5.0, 3.0, 1.0};
  Values copy = values;
  EXPECT_EQ(UpperMedian(copy), 3.0);
  EXPECT_EQ(UpperQuantile(copy, 0.5), 3.0);
  EXPECT_EQ(NearestQuantile(Sorted(values), 0.5), 3.0);
  EXPECT_EQ(InterpolatedQuantile(Sorted(values), 0.5), 3.0);
}

TEST(StatisticsTest, TheLimitsAreTheSmallestAndTheLargestValue) {
  for (const Values& values : {Values{7.0}, Values{1.0, 2.0}, Values{1.0, 2.0, 4.0, 8.0}}) {
    Values copy = values;
    EXPECT_EQ(UpperQuantile(copy, 0.0), values.front());
    EXPECT_EQ(UpperQuantile(copy, 1.0), values.back());
    EXPECT_EQ(NearestQuantile(values, 0.0), values.front());
    EXPECT_EQ(NearestQuantile(values, 1.0), values.back());
    EXPECT_EQ(InterpolatedQuantile(values, 0.0), values.front());
    EXPECT_EQ(InterpolatedQuantile(values, 1.0), values.back());
  }
}

TEST(StatisticsTest, QuantilesRoundAsTheirDefinitionsSay) {
  const Values values = {0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0};
  Values copy = values;
  EXPECT_EQ(UpperQuantile(copy, 0.75), 7.0);  // 7.5 of 10
  EXPECT_EQ(NearestQuantile(values, 0.75), 7.0);
  EXPECT_EQ(InterpolatedQuantile(values, 0.75), 6.75);
}

}  // namespace
}  // namespace evpose
