// SPDX-License-Identifier: Apache-2.0

// The picture of evpose calibrate: residuals by speed and by event density, before and after the fit.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/calibration/sensor_calibration.h"

namespace evpose::client {

// Returns a PNG file of two rows, residuals over speed and over density, with a panel of the residuals and one of their
// remainder after the correction. Each point is the mean of a bin; all bins have about the same number of passages.
// Errors: INTERNAL if the image cannot be encoded.
absl::StatusOr<std::string> DrawCalibration(const SensorCalibration& calibration,
                                            absl::Span<const CalibrationRecording> recordings);

}  // namespace evpose::client
