// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/edge_response.h"

#include <gtest/gtest.h>

#include <cmath>

namespace evpose {
namespace {

// Position at which the blurred step reaches a share of its height, by bisection.
double PhiInverse(double share) {
  double low = -8.0, high = 8.0;
  for (int i = 0; i < 80; ++i) {
    const double middle = 0.5 * (low + high);
    (0.5 * std::erfc(-middle / std::sqrt(2.0)) < share ? low : high) = middle;
  }
  return low;
}

// Mean position of the levels between `first` and `last` on a step of log contrast `contrast`.
double MeanPlace(double contrast, double first, double last) {
  constexpr int kLevels = 4000;
  double sum = 0.0;
  for (int i = 0; i < kLevels; ++i) {
    const double level = first + (i + 0.5) / kLevels * (last - first);
    sum += PhiInverse(std::expm1(level) / std::expm1(contrast));
  }
  return sum / kLevels;
}

TEST(EdgeResponse, EqualsTheMeanPositionOfTheCrossedLevels) {
  const EdgeResponse& response = EdgeResponse::Get();
  for (const double contrast : {0.25, 0.5, 1.0, 2.0, 4.0}) {
    for (const double hysteresis : {0.0, 0.1, 0.4, 0.8}) {
      SCOPED_TRACE(::testing::Message() << "contrast " << contrast << ", hysteresis " << hysteresis);
      const double skipped = hysteresis * contrast;
      EXPECT_NEAR(response.MeanOfOnEvents(contrast, hysteresis), -MeanPlace(contrast, skipped, contrast), 2e-3);
      EXPECT_NEAR(response.MeanOfOffEvents(contrast, hysteresis), MeanPlace(contrast, 0.0, contrast - skipped), 2e-3);
    }
  }
}

TEST(EdgeResponse, AFaintEdgeOnlyLags) {
  const EdgeResponse& response = EdgeResponse::Get();
  EXPECT_NEAR(response.MeanOfOnEvents(0.0, 0.0), 0.0, 1e-6);
  EXPECT_NEAR(response.MeanOfOnEvents(0.0, 0.5), response.MeanOfOffEvents(0.0, 0.5), 1e-3);
  EXPECT_NEAR(response.MeanOfOnEvents(0.0, 0.5), -std::sqrt(2.0 / 3.14159265358979),
              2e-3);  // mean of a half-normal distribution
}

TEST(EdgeResponse, ClampsToItsTable) {
  const EdgeResponse& response = EdgeResponse::Get();
  EXPECT_EQ(response.MeanOfOnEvents(50.0, 2.0), response.MeanOfOnEvents(5.0, 0.9));
  EXPECT_EQ(response.MeanOfOffEvents(-1.0, -1.0), response.MeanOfOffEvents(0.0, 0.0));
}

}  // namespace
}  // namespace evpose
