// SPDX-License-Identifier: Apache-2.0

// The bearings of all pixels of a camera.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/numerics/prefetch.h"

namespace evpose {

// The bearings of all pixels: (x, y) of K^-1 (u, v, 1) with the distortion removed. Memory: 4 bytes for each column and
// row of a camera without distortion, 8 bytes for each pixel of a camera with distortion.
class UndistortionTable {
 public:
  // Has yield points (core/base/yield_point.h). Errors: INVALID_ARGUMENT for an invalid camera, or if the distortion
  // cannot be inverted at some pixel.
  static absl::StatusOr<UndistortionTable> Create(const CameraModel& camera);
  // The bearings of the same pixels in the frame of a turned view of the camera. A pixel whose direction is more than
  // 85 degrees from the axis of the view has a bearing far outside the image. Memory: 8 bytes for each pixel.
  UndistortionTable Turned(const Eigen::Matrix3d& view_from_camera) const;

  // The first two components of the bearing (x, y, 1) of a pixel inside the sensor. A pixel of a fisheye lens that is
  // more than 85 degrees from the optical axis has a bearing far outside the image.
  Eigen::Vector2f Bearing(int x, int y) const {
    if (bearings_.empty()) return {columns_[x], rows_[y]};
    return bearings_[static_cast<size_t>(y) * columns_.size() + x];
  }
  // The size of the sensor.
  int width_px() const { return static_cast<int>(columns_.size()); }
  int height_px() const { return static_cast<int>(rows_.size()); }
  // Whether the bearings are stored by pixel; otherwise the first component depends on x alone, and the second on y.
  bool HasBearingOfEachPixel() const { return !bearings_.empty(); }
  // Prefetches the entry of Bearing(x, y). The pixel may lie outside the sensor.
  void Prefetch(int x, int y) const { PrefetchEntry(bearings_, static_cast<size_t>(y) * columns_.size() + x); }

 private:
  struct LensLimits;

  absl::Status AddDistortedRow(const CameraModel& camera, const LensLimits& limits, int v);

  // The bearings without distortion: x by column, y by row.
  std::vector<float> columns_;
  std::vector<float> rows_;
  std::vector<Eigen::Vector2f> bearings_;  // with distortion, row by row; empty for a camera without distortion
};

}  // namespace evpose
