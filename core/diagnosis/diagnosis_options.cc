// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/diagnosis_options.h"

#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

absl::Status CheckLimits(const char* field, const Limits& limits, double high) {
  EVPOSE_RETURN_IF_ERROR(CheckRange(absl::StrCat(field, ".advice").c_str(), limits.advice, 0.0, high));
  return CheckRange(absl::StrCat(field, ".problem").c_str(), limits.problem, limits.advice, high);
}

absl::Status CheckOrder(const char* field, const Range& range) {
  EVPOSE_RETURN_IF_ERROR(CheckPositive(absl::StrCat(field, ".low").c_str(), range.low));
  return CheckRange(absl::StrCat(field, ".high").c_str(), range.high, range.low, 1e9);
}

}  // namespace

absl::Status DiagnosisOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("false_alarm_probability", false_alarm_probability, 0.0, 0.5, OpenEnds::kLow));
  EVPOSE_RETURN_IF_ERROR(CheckRange("hot_ratio", hot_ratio, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_flicker_hz", min_flicker_hz, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_coherence", min_coherence, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("advice_speed_px_per_s", advice_speed_px_per_s, 0.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckRange("problem_speed_px_per_s", problem_speed_px_per_s, 0.0, advice_speed_px_per_s));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_flicker_parts", min_flicker_parts, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_events_in_20_ms", min_events_in_20_ms, 0.0, 1e9));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_pixels", static_cast<double>(max_pixels), 1.0, 1e8));
  for (const auto& [field, limits, high] :
       {std::tuple("hot_share", hot_share, 1.0), std::tuple("noise_share", noise_share, 1.0),
        std::tuple("flicker_share", flicker_share, 1.0), std::tuple("polarity_ratio", polarity_ratio, 1e6),
        std::tuple("blur_px", blur_px, 1e3), std::tuple("dead_share", dead_share, 1.0),
        std::tuple("event_rate_per_s", event_rate_per_s, 1e12), std::tuple("time_step_us", time_step_us, 1e9),
        std::tuple("step_back_us", step_back_us, 1e12), std::tuple("gap_us", gap_us, 1e12),
        std::tuple("decode_fault_share", decode_fault_share, 1.0)}) {
    EVPOSE_RETURN_IF_ERROR(CheckLimits(field, limits, high));
  }
  for (const auto& [field, range] :
       {std::pair("usual_diameter_m", usual_diameter_m), std::pair("possible_diameter_m", possible_diameter_m),
        std::pair("usual_distance_m", usual_distance_m), std::pair("possible_distance_m", possible_distance_m)}) {
    EVPOSE_RETURN_IF_ERROR(CheckOrder(field, range));
  }
  return absl::OkStatus();
}

}  // namespace evpose
