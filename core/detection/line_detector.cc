// SPDX-License-Identifier: Apache-2.0
#include "core/detection/line_detector.h"

#include "absl/strings/str_format.h"

namespace evpose {

absl::Status CheckSensor(SensorGeometry geometry) {
  if (geometry.width_px > 0 && geometry.height_px > 0) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("the sensor has %d x %d pixels; both must be positive", geometry.width_px, geometry.height_px));
}

}  // namespace evpose
