// SPDX-License-Identifier: Apache-2.0

// Which parts of which lines the camera sees: field of view, faces turned away, lines hidden by other faces.
#pragma once

#include <vector>

#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/triangle_bvh.h"

namespace evpose {

// A visible part of a model line: from P1 + begin (P2 - P1) to P1 + end (P2 - P1), 0 <= begin < end <= 1.
struct VisibleSegment {
  int line = 0;  // index into ObjectModel::lines
  double begin = 0.0;
  double end = 1.0;
};

struct VisibilityOptions {
  int samples_per_line = 16;        // a partly visible line is split at this resolution, then bisected
  double surface_tolerance = 1e-3;  // of the model's diameter: a point this close behind a face lies on it
  double min_length_px = 4.0;       // shorter visible pieces are not returned
  // Faces seen at a cosine below this (negative: turned away by as much) still show their lines.
  // core/association/README.md, section 3: grazing faces are kept, never dropped by a threshold at the predicted pose
  // alone.
  double grazing_cosine = -0.02;

  absl::Status Validate() const;
};

// Ray casting against the mesh with a bounding volume hierarchy. Immutable after construction; thread-compatible.
// Keeps a reference: `model` must outlive it.
class VisibilityTester {
 public:
  VisibilityTester(const ObjectModel& model, const VisibilityOptions& options);

  // Segments in order of line index, then begin.
  std::vector<VisibleSegment> VisibleSegments(const CameraModel& camera,
                                              const RigidTransform& camera_from_object) const;
  // The same in place of what `segments` holds, whose memory is used again.
  void FindVisibleSegments(const CameraModel& camera, const RigidTransform& camera_from_object,
                           std::vector<VisibleSegment>& segments) const;
  // True when the segment from `origin_object` to `point_object` meets no face before the point.
  bool IsPointVisible(const Eigen::Vector3d& origin_object, const Eigen::Vector3d& point_object) const;

 private:
  const ObjectModel* model_;
  VisibilityOptions options_;
  TriangleBvh faces_;
  double tolerance_m_;
};

}  // namespace evpose
