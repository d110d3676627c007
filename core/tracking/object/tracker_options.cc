// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/tracker_options.h"

#include "absl/strings/str_cat.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

absl::Status InGroup(const char* group, const absl::Status& status) {
  if (status.ok()) return status;
  return absl::InvalidArgumentError(absl::StrCat("tracker options, ", group, ".", status.message()));
}

}  // namespace

absl::Status InitializationOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("memory_us", memory_us, 1000, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_window_events", max_window_events, 100, 100'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_events", max_events, max_window_events, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_events", min_events, 1, 100'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("retry_us", retry_us, 1, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_retry_us", max_retry_us, retry_us, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_no_pose_retry_us", max_no_pose_retry_us, max_retry_us, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("repeat_us", repeat_us, 1, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("num_repeats", num_repeats, 0, 100));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_candidates", max_candidates, 1, 100));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("decision_sigma", decision_sigma));
  EVPOSE_RETURN_IF_ERROR(CheckRange("model_error_ratio", model_error_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_compared_events", max_compared_events, 1, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("merge_rad", merge_rad, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("rival_interval_us", rival_interval_us, 1, 60'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("num_rival_rounds", num_rival_rounds, 0, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("tilt_rad", tilt_rad, merge_rad, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("tilt_view_rad", tilt_view_rad, 0.001, 3.2));
  EVPOSE_RETURN_IF_ERROR(CheckRange("tilt_residual_growth", tilt_residual_growth, 1.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckRange("merge_depth_ratio", merge_depth_ratio, 0.0, 1.0));
  return CheckRange("undecided_us", undecided_us, 0, 60'000'000);
}

std::unique_ptr<WindowEstimator> TrackerOptions::MakeEstimator(const CameraModel& camera) const {
  return estimator_factory ? estimator_factory(*this, camera) : MakeMixtureEstimator(*this, camera);
}

absl::Status TrackerOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(InGroup("sensor", sensor.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("windows", windows.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("visibility", visibility.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("elements", elements.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("initial", initial.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("initialization", initialization.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("motion", motion.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("mixture", mixture.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("edge", edge.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("systematic", systematic.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("flash", flash.Validate()));
  return InGroup("health", health.Validate());
}

}  // namespace evpose
