// SPDX-License-Identifier: Apache-2.0

// Line trials for the tests of the baselines.
#pragma once

#include <memory>

#include "core/baselines/first_pose/pose_prior.h"
#include "core/experiments/first_pose/line_trial.h"

namespace evpose {

inline constexpr SimulatedObject kAllObjects[] = {SimulatedObject::kPlanar, SimulatedObject::kCube,
                                                  SimulatedObject::kBook, SimulatedObject::kSpacecraft,
                                                  SimulatedObject::kCuboid};

inline std::unique_ptr<LineTrialGenerator> MakeTrials(SimulatedObject object, double noise_px, int spurious = 0,
                                                      int missing = 0) {
  return LineTrialGenerator::Create({object, noise_px, spurious, missing}).value();
}

// Prior with a mean that deviates from the true pose by one draw.
inline PosePrior PriorOf(const LineTrial& trial, double rotation_rad, double translation_ratio, uint64_t seed) {
  PosePrior prior = {trial.camera_from_object, rotation_rad, translation_ratio};
  Random random(seed);
  prior.camera_from_object = prior.Draw(random);
  return prior;
}

}  // namespace evpose
