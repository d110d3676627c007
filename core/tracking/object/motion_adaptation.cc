// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/motion_adaptation.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/geometry/covariance_inverse.h"

namespace evpose {

MotionAdaptation::Innovation MotionAdaptation::Compare(const MotionState& predicted, const MotionState& estimated) {
  const Vector12d x = Minus(estimated, predicted);
  const Matrix12d information = CovarianceInverse(predicted.covariance);
  Innovation innovation;
  innovation.square = x.dot(information * x);
  innovation.expected = 12.0 - information.cwiseProduct(estimated.covariance).sum();
  return innovation;
}

MotionPriorOptions MotionAdaptation::Adapted(const MotionPriorOptions& options) const {
  MotionPriorOptions adapted = options;
  const double root = std::sqrt(ratio());
  adapted.linear_acceleration_density *= root;
  adapted.angular_acceleration_density *= root;
  return adapted;
}

bool MotionAdaptation::IsSignificant(const Innovation& innovation) const {
  // Standard deviations of a chi-square variable with `expected` degrees of freedom, and a margin for few degrees.
  constexpr double kSigma = 5.0;
  constexpr double kMargin = 5.0;
  const double expected = std::clamp(innovation.expected, 0.0, 12.0);
  if (is_limited() || ratio_ == 1.0) return false;
  return !(innovation.square <= expected + kSigma * std::sqrt(2.0 * expected) + kMargin);
}

void MotionAdaptation::Add(const Innovation& innovation) {
  // Relative change of the ratio per degree of freedom. Slow objects have windows with few events, which measure less
  // than one direction: their ratio falls to a hundredth within some thousand windows, about ten seconds.
  constexpr double kGain = 0.02;
  // Largest excess of one window over its expectation: the number of directions of a pose and its twist.
  constexpr double kMaxExcess = 12.0;
  if (is_limited() || !std::isfinite(innovation.square) || !std::isfinite(innovation.expected)) return;
  const double expected = std::clamp(innovation.expected, 0.0, 12.0);
  const double excess = std::clamp(innovation.square - expected, -expected, kMaxExcess);
  ratio_ = std::clamp(ratio_ * (1.0 + kGain * excess), kMinRatio, 1.0);
  Test(expected + excess, expected);
}

void MotionAdaptation::Test(double square, double expected) {
  // Share of a window in the running means, which cover about 200 windows: 0.2 s at 1 kHz.
  constexpr double kForget = 0.005;
  // Least usual variance over the expected one; 0.3 to 0.5 are measured. It limits the weight of one innovation.
  constexpr double kLeastVariance = 0.2;
  // Variance of the innovations in the alternative hypothesis, over the usual one.
  constexpr double kAlternative = 4.0;
  constexpr double kLogAlternative = 2.0 * std::numbers::ln2;
  const double usual = std::clamp(mean_square_ / mean_expected_, kLeastVariance, 1.0);
  evidence_ += 0.5 * (square / usual * (1.0 - 1.0 / kAlternative) - expected * kLogAlternative);
  evidence_ = ratio_ < 1.0 ? std::max(0.0, evidence_) : 0.0;
  mean_square_ += kForget * (square - mean_square_);
  mean_expected_ += kForget * (expected - mean_expected_);
  if (evidence_ > kMaxEvidence) Reset();
}

}  // namespace evpose
