// SPDX-License-Identifier: Apache-2.0

// The estimators of one window's pose that a tracker can be run with, for comparison with the default one.
#pragma once

#include <string_view>
#include <utility>

namespace evpose {

enum class Estimator {
  kMixture,  // pose and twist in the window, normal + uniform mixture, soft association, motion prior
  // For comparison. The paper's: one pose per window, hard association with its gates; its formulas corrected.
  kStaticLs,
  kStaticM,
  kStaticS,
  kStaticMm,
  kErrorStateFilter,  // event by event, with the motion prior, as line-SLAM with events does
  // The static ones as the paper's released code computes: no visibility, no prediction (core/estimation/README.md,
  // section 1).
  kReleasedLs,
  kReleasedM,
  kReleasedS,
  kReleasedMm,
};
// Every estimator and what it is called where people choose one.
inline constexpr std::pair<Estimator, std::string_view> kEstimatorNames[] = {
    {Estimator::kMixture, "mixture"},        {Estimator::kStaticLs, "static-ls"},
    {Estimator::kStaticM, "static-m"},       {Estimator::kStaticS, "static-s"},
    {Estimator::kStaticMm, "static-mm"},     {Estimator::kErrorStateFilter, "error-state-filter"},
    {Estimator::kReleasedLs, "released-ls"}, {Estimator::kReleasedM, "released-m"},
    {Estimator::kReleasedS, "released-s"},   {Estimator::kReleasedMm, "released-mm"},
};

}  // namespace evpose
