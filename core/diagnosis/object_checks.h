// SPDX-License-Identifier: Apache-2.0

// Checks of a camera and of a model against the events of a recording (core/diagnosis/README.md, section 10).
#pragma once

#include <string>

#include "core/diagnosis/diagnosis_options.h"
#include "core/diagnosis/finding.h"
#include "core/diagnosis/pixel_counts.h"
#include "core/events/decoder.h"
#include "core/geometry/camera.h"
#include "core/recordings/recording_header.h"

namespace evpose {

// The sizes of camera and sensor, and whether a lens may have the camera's numbers.
Finding CheckCamera(const CameraModel& camera, const RecordingHeader& header, const PixelCounts::Box& extent,
                    const DecodeCounts& counts);

// The size of the model, and with it the distance at which it is as large as the moving region. `scale` is that of
// --scale, for the remedy. `extent_px` is 0 if nothing moves.
Finding CheckScale(double diameter_m, double scale, const CameraModel& camera, double extent_px,
                   const DiagnosisOptions& options);

// The extent of the moving region in the image.
Finding CheckObjectSize(double extent_px);

}  // namespace evpose
