// SPDX-License-Identifier: Apache-2.0

// The picture of `evpose camera`.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"

namespace evpose::client {

// Draws, as PNG, where the lens shows straight lines, which lie 10 degrees apart at the axis, and the directions at
// multiples of 10 degrees from it, up to the fold of the distortion. A lens without distortion shows straight lines.
absl::StatusOr<std::vector<uint8_t>> DrawCamera(const CameraModel& camera);

}  // namespace evpose::client
