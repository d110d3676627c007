// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/systematic_error.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace evpose {
namespace {

// One window of a filter that gives the prediction a weight of 1 - kGain.
constexpr double kGain = 0.25;
const Matrix12d kPriorInformation = (1.0 - kGain) * Matrix12d::Identity();
const Matrix12d kCovariance = Matrix12d::Identity();

SystematicOptions Only(double SystematicOptions::*constant, double value) {
  SystematicOptions options{0.0, 0.0, 0.0};
  options.*constant = value;
  return options;
}

TEST(SystematicError, ConvergesToTheErrorOfTheEventsAlone) {
  SystematicError error;
  SystematicGradients gradients;
  gradients.by_lag[2] = -kGain * 0.01;  // the events of each window have an error of 0.01 m
  error.Update(kPriorInformation, 0.0, kCovariance, gradients, 1);
  const SystematicOptions options = Only(&SystematicOptions::lag_px, 1.0);
  EXPECT_NEAR(error.Covariance(options, 1.0, Vector6d::Zero())(2, 2), std::pow(kGain * 0.01, 2), 1e-12);
  error.Update(kPriorInformation, 0.0, kCovariance, gradients, 100);
  const Matrix6d covariance = error.Covariance(options, 1.0, Vector6d::Zero());
  EXPECT_NEAR(covariance(2, 2), 1e-4, 1e-9);
  EXPECT_NEAR(covariance.trace(), 1e-4, 1e-9);
}

TEST(SystematicError, AnErrorOfTheTwistMovesThePose) {
  SystematicError error;
  SystematicGradients gradients;
  gradients.by_edge_bias[6] = -kGain * 2.0;
  error.Update(kPriorInformation, 0.001, kCovariance, gradients, 200);
  // In equilibrium x = (1 - kGain) (x + T v) with v = 2 m/s.
  const double x_m = (1.0 - kGain) / kGain * 0.001 * 2.0;
  const SystematicOptions options = Only(&SystematicOptions::edge_bias_ratio, 0.5);
  EXPECT_NEAR(error.Covariance(options, 1.0, Vector6d::Zero())(0, 0), std::pow(0.5 * x_m, 2), 1e-10);
}

TEST(SystematicError, ALatencyIsAnErrorAlongTheMotion) {
  Vector6d twist = Vector6d::Zero();
  twist[0] = 2.0;
  twist[4] = -3.0;
  const Matrix6d covariance = SystematicError().Covariance(Only(&SystematicOptions::latency_us, 100.0), 0.5, twist);
  EXPECT_NEAR(covariance(0, 0), 1e-8, 1e-16);
  EXPECT_NEAR(covariance(0, 4), -1.5e-8, 1e-16);
  EXPECT_EQ(covariance(1, 1), 0.0);
}

TEST(SystematicError, OptionsNameTheInvalidField) {
  SystematicOptions options;
  EXPECT_TRUE(options.Validate().ok());
  options.lag_px = -1.0;
  EXPECT_THAT(std::string(options.Validate().message()), ::testing::HasSubstr("lag_px"));
}

}  // namespace
}  // namespace evpose
