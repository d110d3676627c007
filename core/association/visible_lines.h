// SPDX-License-Identifier: Apache-2.0

// The lines that take part: what is visible at the present pose, looked up again only when the view has changed.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "core/association/association.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

class VisibleLines {
 public:
  // `model` and `tester`, which is the model's, must outlive it.
  VisibleLines(const ObjectModel& model, const CameraModel& camera, const VisibilityTester& tester);

  // The visible parts of lines; valid until the next call.
  absl::Span<const TrackedLine> At(const RigidTransform& camera_from_object);

  // Where the lines were looked up is all that has to be known of the past.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  // TrackedLine::narrowest_face_px, from the camera's centre in the object frame; no face is wider than the object.
  void MeasureFaces(const Eigen::Vector3d& eye);
  void LookFrom(const RigidTransform& camera_from_object);
  bool ViewChanged(const RigidTransform& camera_from_object) const;
  // For each face of each line, whether it is turned to the camera. It decides which lines show, and matters to the
  // last tenth of a degree: a line kept too long on a face that has turned away holds the pose there, and one missed
  // too long gives its events to its neighbour (core/association/README.md, section 3).
  void FacingFaces(const Eigen::Vector3d& eye, std::vector<bool>& facing) const;

  const ObjectModel& model_;
  const CameraModel camera_;
  const VisibilityTester& tester_;
  std::optional<RigidTransform> looked_from_;
  std::vector<bool> facing_;
  std::vector<bool> facing_now_;
  std::vector<VisibleSegment> segments_;
  std::vector<TrackedLine> lines_;
};

}  // namespace evpose
