#include "core/tracking/sensor_profile.h"

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

absl::Status Between(const char* field, double value, double low, double high) {
  if (value >= low && value <= high) return absl::OkStatus();  // also false for NaN
  return absl::InvalidArgumentError(absl::StrCat(field, " must be between ", low, " and ", high, ": ", value));
}

}  // namespace

absl::Status SensorProfile::Validate() const {
  EVPOSE_RETURN_IF_ERROR(Between("pixel_noise_px", pixel_noise_px, 0.05, 10.0));
  EVPOSE_RETURN_IF_ERROR(Between("blur_px", blur_px, 0.0, 5.0));
  EVPOSE_RETURN_IF_ERROR(Between("contrast_threshold", contrast_threshold, 0.01, 2.0));
  return Between("latency_us", latency_us, -10'000.0, 10'000.0);
}

}  // namespace evpose
