#include "core/tracking/estimator.h"

namespace evpose {

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
