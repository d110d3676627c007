// SPDX-License-Identifier: Apache-2.0

// Estimators with which a tracker can be run, to compare them with the default one.
#pragma once

#include <string_view>
#include <utility>

namespace evpose {

enum class Estimator {
  kMixture,  // pose and twist in the window, normal + uniform mixture, soft association, motion prior
  // The static estimators of the paper, for comparison: one pose per window, hard association with its gates, corrected
  // formulas.
  kStaticLs,
  kStaticM,
  kStaticS,
  kStaticMm,
  kErrorStateFilter,  // event by event, with the motion prior (error_state_filter.h)
  // The static estimators as the released code of the paper computes them: no visibility, no prediction
  // (core/estimation/README.md, section 1).
  kReleasedLs,
  kReleasedM,
  kReleasedS,
  kReleasedMm,
};
// Every estimator with its name on the command line and in files.
inline constexpr std::pair<Estimator, std::string_view> kEstimatorNames[] = {
    {Estimator::kMixture, "mixture"},        {Estimator::kStaticLs, "static-ls"},
    {Estimator::kStaticM, "static-m"},       {Estimator::kStaticS, "static-s"},
    {Estimator::kStaticMm, "static-mm"},     {Estimator::kErrorStateFilter, "error-state-filter"},
    {Estimator::kReleasedLs, "released-ls"}, {Estimator::kReleasedM, "released-m"},
    {Estimator::kReleasedS, "released-s"},   {Estimator::kReleasedMm, "released-mm"},
};

}  // namespace evpose
