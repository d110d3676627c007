// SPDX-License-Identifier: Apache-2.0

// Makes any of the estimators for a tracker: TrackerOptions.estimator_factory =
// EstimatorFactoryOf(Estimator::kStaticMm).
#pragma once

#include "core/baselines/estimators/estimator_kind.h"
#include "core/estimation/estimator.h"

namespace evpose {

// Each with the default options of its own.
EstimatorFactory EstimatorFactoryOf(Estimator estimator);

}  // namespace evpose
