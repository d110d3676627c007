// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/tracker_options.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/tracking/option_checks.h"

namespace evpose {
namespace {

absl::Status InGroup(const char* group, const absl::Status& status) {
  if (status.ok()) return status;
  return absl::InvalidArgumentError(absl::StrCat("tracker options, ", group, ".", status.message()));
}

}  // namespace

absl::Status InitialPoseOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Positive("lateral_px", lateral_px));
  EVPOSE_RETURN_IF_ERROR(Positive("depth_ratio", depth_ratio));
  EVPOSE_RETURN_IF_ERROR(Positive("rotation_rad", rotation_rad));
  EVPOSE_RETURN_IF_ERROR(Positive("velocity_px_per_s", velocity_px_per_s));
  return Positive("angular_velocity_rad_per_s", angular_velocity_rad_per_s);
}

absl::Status MotionPriorOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Positive("linear_acceleration_density", linear_acceleration_density));
  EVPOSE_RETURN_IF_ERROR(Positive("angular_acceleration_density", angular_acceleration_density));
  EVPOSE_RETURN_IF_ERROR(Positive("turn_time_s", turn_time_s));
  return Between("retry_noise_factor", retry_noise_factor, 1.0, 1e6);
}

absl::Status MixtureOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Between("sigma_min_factor", sigma_min_factor, 0.1, 1.0));
  EVPOSE_RETURN_IF_ERROR(Between("sigma_max_factor", sigma_max_factor, 1.0, 10.0));
  EVPOSE_RETURN_IF_ERROR(Between("gate_px", gate_px, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(Between("max_gate_px", max_gate_px, gate_px, 64.0));
  EVPOSE_RETURN_IF_ERROR(Between("retry_gate_factor", retry_gate_factor, 1.0, 10.0));
  EVPOSE_RETURN_IF_ERROR(Between("max_passes", max_passes, 1, 100));
  EVPOSE_RETURN_IF_ERROR(Between("max_events", max_events, 50, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(Between("events_per_information", events_per_information, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(Between("edge_noise_px_sqrt_s", edge_noise_px_sqrt_s, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(Between("usual_displacement_px", usual_displacement_px, 1e-3, 10.0));
  return Between("min_events_per_px2", min_events_per_px2, 0.0, 100.0);
}

absl::Status EdgeOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Positive("min_events", min_events));
  EVPOSE_RETURN_IF_ERROR(Positive("memory_events", memory_events));
  return Positive("turn_memory_px2", turn_memory_px2);
}

absl::Status StaticOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Between("distance_px", distance_px, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(Between("released_distance_px", released_distance_px, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(Between("midpoint_ratio", midpoint_ratio, 0.1, 1.0));
  EVPOSE_RETURN_IF_ERROR(Between("two_lines_px", two_lines_px, 0.0, distance_px));
  EVPOSE_RETURN_IF_ERROR(Between("max_iterations", max_iterations, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(Positive("tolerance_px", tolerance_px));
  return Between("max_events", max_events, 50, 1'000'000);
}

absl::Status ErrorStateFilterOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Between("sigma_px", sigma_px, 0.1, 20.0));
  EVPOSE_RETURN_IF_ERROR(Between("gate_px", gate_px, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(Between("two_lines_px", two_lines_px, 0.0, gate_px));
  EVPOSE_RETURN_IF_ERROR(Between("gate_chi2", gate_chi2, 0.1, 1000.0));
  EVPOSE_RETURN_IF_ERROR(Between("injection_s", injection_s, 1e-6, 1.0));
  EVPOSE_RETURN_IF_ERROR(Between("events_per_information", events_per_information, 1.0, 1000.0));
  return Between("max_events", max_events, 50, 1'000'000);
}

absl::Status HealthOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Between("gate_px", gate_px, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(Between("near_px", near_px, 0.1, 0.5 * gate_px));
  EVPOSE_RETURN_IF_ERROR(Positive("significance_sigma", significance_sigma));
  EVPOSE_RETURN_IF_ERROR(Between("dispersion", dispersion, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(Between("max_noise_hz_per_px", max_noise_hz_per_px, 0.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(Between("min_events", min_events, 1, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(Positive("min_span_us", static_cast<double>(min_span_us)));
  EVPOSE_RETURN_IF_ERROR(Between("confirm_support_ratio", confirm_support_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(Between("keep_support_ratio", keep_support_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(Positive("memory_us", static_cast<double>(memory_us)));
  EVPOSE_RETURN_IF_ERROR(Between("min_tested_ratio", min_tested_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(Between("max_hold_us", static_cast<double>(max_hold_us), 0.0, 1e9));
  EVPOSE_RETURN_IF_ERROR(Positive("patience_us", static_cast<double>(patience_us)));
  EVPOSE_RETURN_IF_ERROR(Positive("lost_after_us", static_cast<double>(lost_after_us)));
  EVPOSE_RETURN_IF_ERROR(Between("max_unconfirmed_verdicts", max_unconfirmed_verdicts, 1, 1000));
  return Positive("max_uncertainty_px", max_uncertainty_px);
}

absl::Status InitializationOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Between("memory_us", memory_us, 1000, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(Between("max_window_events", max_window_events, 100, 100'000));
  EVPOSE_RETURN_IF_ERROR(Between("max_events", max_events, max_window_events, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(Between("min_events", min_events, 1, 100'000));
  EVPOSE_RETURN_IF_ERROR(Between("retry_us", retry_us, 1, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(Between("max_retry_us", max_retry_us, retry_us, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(Between("max_vain_retry_us", max_vain_retry_us, max_retry_us, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(Between("review_us", review_us, 1, 10'000'000));
  EVPOSE_RETURN_IF_ERROR(Between("num_reviews", num_reviews, 0, 100));
  EVPOSE_RETURN_IF_ERROR(Between("max_candidates", max_candidates, 1, 100));
  EVPOSE_RETURN_IF_ERROR(Positive("decision_sigma", decision_sigma));
  return Between("undecided_us", undecided_us, 0, 60'000'000);
}

absl::Status TrackerOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(InGroup("sensor", sensor.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("windows", windows.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("visibility", visibility.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("initial", initial.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("initialization", initialization.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("motion", motion.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("mixture", mixture.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("edge", edge.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("static_fit", static_fit.Validate()));
  EVPOSE_RETURN_IF_ERROR(InGroup("error_state_filter", error_state_filter.Validate()));
  return InGroup("health", health.Validate());
}

}  // namespace evpose
