// SPDX-License-Identifier: Apache-2.0

// Factories of the estimators for a tracker: TrackerOptions.estimator_factory =
// EstimatorFactoryOf(Estimator::kStaticMm).
#pragma once

#include "core/baselines/estimators/estimator_kind.h"
#include "core/estimation/estimator.h"

namespace evpose {

// Returns the factory of an estimator with the default options.
EstimatorFactory EstimatorFactoryOf(Estimator estimator);

}  // namespace evpose
