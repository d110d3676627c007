// SPDX-License-Identifier: Apache-2.0

// The picture of `evpose camera`.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"

namespace evpose::client {

// Returns a PNG file: the images of a grid of straight lines, and circles of the directions at equal angles to the
// optical axis, up to the fold of the distortion. Lines and circles are 10 degrees apart, less for a narrow field of
// view. Without distortion the images of the lines are straight. Errors: INTERNAL if the image cannot be encoded.
absl::StatusOr<std::string> DrawCamera(const CameraModel& camera);

}  // namespace evpose::client
