// SPDX-License-Identifier: Apache-2.0

// Adapts the densities of the motion prior to the motion (core/tracking/README.md, section 4): a turntable and a hand
// differ in their accelerations by a factor of a hundred.
#pragma once

#include <algorithm>

#include "core/base/state_io.h"
#include "core/geometry/motion_prior.h"

namespace evpose {

class MotionAdaptation {
 public:
  // The difference between an estimate and its prediction, compared with the expected one.
  struct Innovation {
    double square = 0.0;    // x^T P^-1 x, README, equation (3)
    double expected = 0.0;  // its expectation: the number of directions that the events measured
  };
  static Innovation Compare(const MotionState& predicted, const MotionState& estimated);

  // The options with densities reduced by the present ratio.
  MotionPriorOptions Adapted(const MotionPriorOptions& options) const;
  // Whether the innovation shows an acceleration that the reduced densities exclude.
  bool IsSurprising(const Innovation& innovation) const;
  // Sets the ratio for a window with few events, which tell less about the motion than their number (README, equation
  // (7)); 1: the ratio that was learned applies.
  void Limit(double ratio) { limit_ = std::clamp(ratio, kMinRatio, 1.0); }
  // Returns to the full densities.
  void Reset() { ratio_ = 1.0; }
  // Adds the innovation of an accepted window.
  void Add(const Innovation& innovation);

  // Of the squares of the densities, in [kMinRatio, 1].
  double ratio() const { return is_limited() ? limit_ : ratio_; }

  // The densities are at most a factor of 30 below those of the options.
  static constexpr double kMinRatio = 1e-3;

  static void VisitState(auto& archive, auto& self) {
    auto& [ratio, limit] = self;
    archive(InRange(ratio, kMinRatio, 1.0));
  }

 private:
  bool is_limited() const { return limit_ < 1.0; }

  double ratio_ = 1.0;
  double limit_ = 1.0;  // not saved: it is set for each window
};

}  // namespace evpose
