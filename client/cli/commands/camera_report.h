// SPDX-License-Identifier: Apache-2.0

// The report of evpose calibrate about a camera.
#pragma once

#include <ostream>
#include <string>

#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "core/calibration/camera_calibration.h"

namespace evpose::client {

Json CameraCalibrationJson(const CameraCalibration& calibration);
void PrintCameraCalibration(const CameraCalibration& calibration, std::ostream& out);

// Returns a PNG file of the image of the camera. The shade of each cell shows its number of samples, its text the RMS
// of their residuals in pixels. The uncertainties of the projection are written at their places. Errors: INTERNAL if
// the image cannot be encoded.
absl::StatusOr<std::string> DrawCoverage(const CameraCalibration& calibration);

}  // namespace evpose::client
