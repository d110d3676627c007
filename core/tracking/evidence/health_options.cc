// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/health_options.h"

#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {

absl::Status HealthOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("gate_px", gate_px, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("near_px", near_px, 0.1, 0.5 * gate_px));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_spread_px", max_spread_px, 0.05, gate_px));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_spread_px", min_spread_px, 0.05, max_spread_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("significance_sigma", significance_sigma));
  EVPOSE_RETURN_IF_ERROR(CheckRange("power_sigma", power_sigma, significance_sigma, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("dispersion", dispersion, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_noise_hz_per_px", max_noise_hz_per_px, 0.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_excess_ratio", min_excess_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("wide_spread_px", wide_spread_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_contrast", min_contrast));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("contrast_memory_us", static_cast<double>(contrast_memory_us)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_events", min_events, 1, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_span_us", static_cast<double>(min_span_us)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("confirm_support_ratio", confirm_support_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("keep_support_ratio", keep_support_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("confirm_lines", confirm_lines, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("keep_lines", keep_lines, 1, confirm_lines));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_signal_events", min_signal_events, 0.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("memory_us", static_cast<double>(memory_us)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_tested_ratio", min_tested_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_hold_us", static_cast<double>(max_hold_us), 0.0, 1e9));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_missing_sectors", max_missing_sectors, 0, kNumOutlineSectors));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_displaced_ratio", max_displaced_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_contradiction_us", static_cast<double>(min_contradiction_us)));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("lost_after_us", static_cast<double>(lost_after_us)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_contradictions", max_contradictions, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("max_uncertainty_px", max_uncertainty_px));
  return CheckPositive("sure_uncertainty_px", sure_uncertainty_px);
}

}  // namespace evpose
