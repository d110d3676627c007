// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "core/association/association.h"
#include "core/geometry/camera.h"

namespace evpose::testing {

// An event at this undistorted pixel in the middle of the window, without candidate lines.
inline Observation ObservationAt(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  const Eigen::Vector3d bearing = BearingOf(camera, pixel);
  Observation event;
  event.bx = bearing.x();
  event.by = bearing.y();
  event.u_px = pixel.x();
  event.v_px = pixel.y();
  return event;
}

}  // namespace evpose::testing
