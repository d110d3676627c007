// SPDX-License-Identifier: Apache-2.0

// The visible parts of the model's lines at a pose. They are computed by ray casting, and again only when the view has
// changed.
#pragma once

#include <optional>
#include <vector>

#include "core/association/association.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

class VisibleEdges {
 public:
  // `tester` must be that of `model`; both must outlive the object.
  VisibleEdges(const ObjectModel& model, const CameraModel& camera, const VisibilityTester& tester);

  // Returns the visible parts of the lines, object frame, metres. Valid until the next call.
  absl::Span<const TrackedLine> At(const RigidTransform& camera_from_object);

  // The state is the pose at which the lines were last computed.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  // Sets TrackedLine::narrowest_face_px for the camera centre `eye` (object frame). The bound assumes faces as wide as
  // the object's diameter.
  void MeasureFaces(const Eigen::Vector3d& eye);
  // Computes the visible parts at the pose.
  void ComputeAt(const RigidTransform& camera_from_object);
  bool ViewChanged(const RigidTransform& camera_from_object) const;
  // For each face of each line: whether it faces the camera. This decides about the visibility of lines and must be
  // exact to a tenth of a degree: a line of a face that has turned away pulls the pose back to where the face was
  // visible, and the events of a missing line are attributed to its neighbour (core/association/README.md, section 3).
  void FacingFaces(const Eigen::Vector3d& eye, std::vector<bool>& facing) const;

  const ObjectModel& model_;
  const CameraModel camera_;
  const VisibilityTester& tester_;
  std::optional<RigidTransform> computed_at_;
  std::vector<bool> facing_;
  std::vector<bool> facing_now_;
  std::vector<VisibleSegment> segments_;
  std::vector<TrackedLine> lines_;
};

}  // namespace evpose
