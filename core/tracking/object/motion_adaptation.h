// SPDX-License-Identifier: Apache-2.0

// Adapts the densities of the motion prior to the motion (core/tracking/README.md, section 5): a turntable and a hand
// differ in their accelerations by a factor of a hundred.
#pragma once

#include <algorithm>

#include "core/base/state_io.h"
#include "core/geometry/motion_prior.h"

namespace evpose {

// The constants are validated by motion_adaptation_test. Of the recordings of `evpose bench real`, the cube on a
// turntable depends on them most (core/experiments/RESULTS.md, Tracking: right for 85 % of the time from a given pose).
class MotionAdaptation {
 public:
  // The difference between an estimate and its prediction, compared with the expected one.
  struct Innovation {
    double square = 0.0;    // x^T P^-1 x, README, equation (5)
    double expected = 0.0;  // its expectation: the number of directions that the events measured
  };
  static Innovation Compare(const MotionState& predicted, const MotionState& estimated);

  // The options with densities reduced by the present ratio.
  MotionPriorOptions Adapted(const MotionPriorOptions& options) const;
  // Whether the innovation shows an acceleration that the reduced densities exclude.
  bool IsSignificant(const Innovation& innovation) const;
  // Sets the ratio for a window with few events, in which the innovation contains less information about the motion
  // than the number of events (README, equation (8)). 1: the ratio that Add() has adapted applies.
  void Limit(double ratio) { limit_ = std::clamp(ratio, kMinRatio, 1.0); }
  // Returns to the full densities.
  void Reset() {
    ratio_ = 1.0;
    evidence_ = 0.0;
  }
  // Adds the innovation of an accepted window. Returns to the full densities when the innovations of the latest windows
  // show together that the object accelerates more than the reduced densities allow (README, section 5).
  void Add(const Innovation& innovation);

  // Ratio of the squares of the densities, in [kMinRatio, 1].
  double ratio() const { return is_limited() ? limit_ : ratio_; }

  // The densities are at most a factor of 30 below those of the options.
  static constexpr double kMinRatio = 1e-3;

  static void VisitState(auto& archive, auto& self) {
    auto& [ratio, mean_square, mean_expected, evidence, limit] = self;
    archive(InRange(ratio, kMinRatio, 1.0), InRange(mean_square, 0.0, kMaxMean), InRange(mean_expected, 0.0, kMaxMean),
            InRange(evidence, 0.0, kMaxEvidence));
  }

 private:
  // The log-likelihood ratio at which the full densities are restored. If the reduced ones are right, that happens
  // after more than exp(kMaxEvidence) = 22,000 windows on average (Wald's bound).
  static constexpr double kMaxEvidence = 10.0;

  // Bound of both means: the largest expectation, 12, with the largest excess of one window over it (Add()).
  static constexpr double kMaxMean = 24.0;

  void Test(double square, double expected);
  bool is_limited() const { return limit_ < 1.0; }

  double ratio_ = 1.0;
  // Running means over about 200 windows. Their quotient is the usual variance of an innovation over the expected one;
  // it is below 1 where the events are less uncertain than assumed.
  double mean_square_ = 1.0;
  double mean_expected_ = 1.0;
  double evidence_ = 0.0;  // log-likelihood ratio for innovations of more than the usual variance, in [0, kMaxEvidence]
  double limit_ = 1.0;     // not saved: it is set for each window
};

}  // namespace evpose
