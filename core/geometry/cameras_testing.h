// SPDX-License-Identifier: Apache-2.0

// Cameras for tests.
#pragma once

#include "core/geometry/camera.h"

namespace evpose {

// A lens without distortion, with different focal lengths in x and y and the principal point beside the centre.
inline CameraModel PlainCamera() {
  CameraModel camera;
  camera.width_px = 320;
  camera.height_px = 240;
  camera.fx_px = 300.0;
  camera.fy_px = 290.0;
  camera.cx_px = 161.3;
  camera.cy_px = 118.7;
  return camera;
}

}  // namespace evpose
