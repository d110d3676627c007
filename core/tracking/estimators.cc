// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/estimator.h"

namespace evpose {

void LineAnswer::Add(const LineAnswer& window) {
  for (int half = 0; half < 2; ++half) {
    const double all = expected[half] + window.expected[half];
    const double keep = all > kEnough ? kEnough / all : 1.0;
    expected[half] = std::min(all, kEnough);
    observed[half] = std::clamp(keep * (observed[half] + window.observed[half]), -expected[half], expected[half]);
  }
}

std::unique_ptr<WindowEstimator> MakeWindowEstimator(const TrackerOptions& options, const CameraModel& camera) {
  switch (options.estimator) {
    case Estimator::kMixture:
      return MakeMixtureEstimator(options, camera);
    case Estimator::kErrorStateFilter:
      return MakeErrorStateFilter(options, camera);
    case Estimator::kStaticLs:
    case Estimator::kStaticM:
    case Estimator::kStaticS:
    case Estimator::kStaticMm:
    case Estimator::kReleasedLs:
    case Estimator::kReleasedM:
    case Estimator::kReleasedS:
    case Estimator::kReleasedMm:
      return MakeStaticEstimator(options, camera);
  }
  return MakeMixtureEstimator(options, camera);
}

}  // namespace evpose
