// SPDX-License-Identifier: Apache-2.0

// Draws the events of a window and the model projected at a pose. Pictures of small sensors are enlarged by a whole
// factor, so that lines and text hide little of them.
#pragma once

#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>

#include "core/association/visible_edges.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose::client {

class FramePainter {
 public:
  // Keeps references: the arguments must outlive it.
  FramePainter(const CameraModel& camera, const ObjectModel& model);

  // Begins a new picture.
  void Clear();
  // Events outside the picture are ignored.
  void DrawEvent(const Event& event);
  // Draws the visible edges of the model that the tracker uses: straight lines, curves and contours, with the
  // distortion of the lens; nullopt: none.
  void DrawModel(const std::optional<RigidTransform>& camera_from_object);
  void DrawLegend(int64_t t_us, double window_ms, const std::optional<RigidTransform>& camera_from_object);

  // BGR, 8 bits; scale() pixels for each pixel of the sensor, in each direction.
  const cv::Mat& image() const { return image_; }
  int scale() const { return scale_; }

 private:
  double RelativeHeight() const;  // height of the picture, in units of 480 px
  void DrawText(const std::string& text, int line);

  const CameraModel& camera_;
  const int scale_;
  const ModelEdges edges_;
  VisibleEdges visible_;
  cv::Mat image_;
  uint64_t on_events_ = 0;
  uint64_t off_events_ = 0;
};

}  // namespace evpose::client
