// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/estimators/estimator_factory.h"

#include "core/baselines/estimators/error_state_filter.h"
#include "core/baselines/estimators/static_estimator.h"
#include "core/estimation/mixture_estimator.h"

namespace evpose {

namespace {

struct StaticMethod {
  Estimator estimator;
  LineFitMethod method;
  LineFitFormulas formulas;
};
constexpr StaticMethod kStaticMethods[] = {
    {Estimator::kStaticLs, LineFitMethod::kLeastSquares, LineFitFormulas::kCorrected},
    {Estimator::kStaticM, LineFitMethod::kTukeyM, LineFitFormulas::kCorrected},
    {Estimator::kStaticS, LineFitMethod::kTukeyS, LineFitFormulas::kCorrected},
    {Estimator::kStaticMm, LineFitMethod::kTukeyMm, LineFitFormulas::kCorrected},
    {Estimator::kReleasedLs, LineFitMethod::kLeastSquares, LineFitFormulas::kReleasedCode},
    {Estimator::kReleasedM, LineFitMethod::kTukeyM, LineFitFormulas::kReleasedCode},
    {Estimator::kReleasedS, LineFitMethod::kTukeyS, LineFitFormulas::kReleasedCode},
    {Estimator::kReleasedMm, LineFitMethod::kTukeyMm, LineFitFormulas::kReleasedCode},
};

}  // namespace

EstimatorFactory EstimatorFactoryOf(Estimator estimator) {
  if (estimator == Estimator::kErrorStateFilter) {
    return [](const EstimatorOptions&, const CameraModel& camera) { return MakeErrorStateFilter(camera); };
  }
  for (const StaticMethod& known : kStaticMethods) {
    if (known.estimator != estimator) continue;
    return [known](const EstimatorOptions&, const CameraModel& camera) {
      return MakeStaticEstimator(known.method, known.formulas, camera);
    };
  }
  return MakeMixtureEstimator;
}

}  // namespace evpose
