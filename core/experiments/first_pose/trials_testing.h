// SPDX-License-Identifier: Apache-2.0

// Line trials for the tests of the baselines.
#pragma once

#include <memory>

#include "core/experiments/first_pose/line_trial.h"

namespace evpose {

inline std::unique_ptr<LineTrialGenerator> MakeTrials(SimulatedObject object, double noise_px, int spurious = 0,
                                                      int missing = 0) {
  return LineTrialGenerator::Create({object, noise_px, spurious, missing}).value();
}

}  // namespace evpose
