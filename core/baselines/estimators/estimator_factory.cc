// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/estimators/estimator_factory.h"

#include "core/baselines/estimators/error_state_filter.h"
#include "core/baselines/estimators/static_estimator.h"
#include "core/estimation/mixture_estimator.h"

namespace evpose {

EstimatorFactory EstimatorFactoryOf(Estimator estimator) {
  switch (estimator) {
    case Estimator::kMixture:
      return MakeMixtureEstimator;
    case Estimator::kErrorStateFilter:
      return [](const EstimatorOptions&, const CameraModel& camera) {
        return MakeErrorStateFilter(ErrorStateFilterOptions(), camera);
      };
    case Estimator::kStaticLs:
    case Estimator::kStaticM:
    case Estimator::kStaticS:
    case Estimator::kStaticMm:
    case Estimator::kReleasedLs:
    case Estimator::kReleasedM:
    case Estimator::kReleasedS:
    case Estimator::kReleasedMm:
      return [estimator](const EstimatorOptions&, const CameraModel& camera) {
        return MakeStaticEstimator(estimator, StaticOptions(), camera);
      };
  }
  return MakeMixtureEstimator;
}

}  // namespace evpose
