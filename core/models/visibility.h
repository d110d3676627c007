// SPDX-License-Identifier: Apache-2.0

// The parts of a model's lines that a camera sees: limited by the field of view, by faces turned away and by occlusion
// (core/models/README.md, section 3).
#pragma once

#include <memory>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/mesh/triangle_bvh.h"
#include "core/models/object_model.h"

namespace evpose {

// A visible part of a model line: from P1 + begin (P2 - P1) to P1 + end (P2 - P1), 0 <= begin < end <= 1.
struct VisibleSegment {
  int line = 0;  // index into ObjectModel::lines
  double begin = 0.0;
  double end = 1.0;
};

// The defaults are validated by visibility_test: a bar that splits a line, pieces of 3.3 px, points within and beyond
// the tolerance, and faces that are just turned away. The tracker uses other cosines (TrackerOptions).
struct VisibilityOptions {
  // Steps in which a line is tested for occlusion; a gap shorter than one step may be missed.
  int samples_per_line = 16;
  // Relative to the diameter: a point this close to the plane of a face is on it. Above the rounding errors of
  // drawings.
  double surface_tolerance = 1e-3;
  double min_length_px = 4.0;  // shorter visible parts, which contain hardly any events, are not returned
  // Least cosine between a face's normal and the direction to the camera at which its lines are visible. Negative:
  // faces that are turned away by as much, 1 degree, still count.
  // core/association/README.md, section 3: grazing faces are kept, never dropped by a threshold at the predicted pose
  // alone.
  double grazing_cosine = -0.02;
  // The same for lines that are drawn on a face of a solid, if this value is larger. An object is a solid if some of
  // its lines are edges between two faces. A drawn pattern is compressed to the spread of its events long before the
  // face disappears, and the edge of the face remains.
  double painted_cosine = -1.0;

  absl::Status Validate() const;
};

// The origin of the rays that test a line through `middle` for occlusion; `origin` is the camera's centre before
// (object frame). False if all faces of the line are turned away; a line without faces is never. In a grazing view,
// whether a face hides its own lines would depend on rounding errors of the pose: the origin is moved to where the view
// is no longer grazing (core/models/README.md, section 3).
bool FindRayOrigin(absl::Span<const Eigen::Vector3d> face_normals, const Eigen::Vector3d& middle, double grazing_cosine,
                   Eigen::Vector3d& origin);

// What is seen this far beside an edge, pixels, decides about its contrast. A ray nearer to the edge may meet facets of
// the edge's own surface, or a face that is narrower than the blur of the lens; one farther away another part of the
// object across a narrow gap.
inline constexpr double kBesideEdgePx = 1.5;
// The background begins this many diameters behind an edge: every part of the object is within one.
inline constexpr double kBackgroundDiameters = 2.0;

// An edge as it is seen from `eye`; object frame, metres.
struct SeenEdge {
  Eigen::Vector3d eye;
  Eigen::Vector3d p1, p2;  // the visible part
  double focal_px = 0.0;
};

// What is seen kBesideEdgePx beside the middle of an edge (README, section 3).
enum class EdgeSides {
  kBackground,  // on at least one side the ray meets no face up to kBackgroundDiameters behind the edge
  kParallel,    // the rays meet faces whose normals differ by less than 0.1 rad
  kDifferent,   // the rays meet faces whose normals differ by more
};
EdgeSides SidesOf(const SeenEdge& edge, const TriangleBvh& faces, double diameter_m);

// Tests lines by ray casting against the mesh. Immutable after construction; thread-compatible. Keeps a reference:
// `model` must outlive it. `faces` is the search tree of the triangles that hide lines, those of `model`; null:
// computed here.
class VisibilityTester {
 public:
  VisibilityTester(const ObjectModel& model, const VisibilityOptions& options,
                   std::shared_ptr<const TriangleBvh> faces = nullptr);

  // Segments in order of line index, then begin.
  std::vector<VisibleSegment> VisibleSegments(const CameraModel& camera,
                                              const RigidTransform& camera_from_object) const;
  // The same; replaces the content of `segments` and reuses its memory.
  void FindVisibleSegments(const CameraModel& camera, const RigidTransform& camera_from_object,
                           std::vector<VisibleSegment>& segments) const;
  // The same for a part of the lines, indices into ObjectModel::lines in increasing order.
  void FindVisibleSegments(const CameraModel& camera, const RigidTransform& camera_from_object,
                           absl::Span<const int> lines, std::vector<VisibleSegment>& segments) const;
  // Whether the segment from `origin_object` to `point_object` meets no face before the point.
  bool IsPointVisible(const Eigen::Vector3d& origin_object, const Eigen::Vector3d& point_object) const;
  // The search tree of the model's triangles.
  const TriangleBvh& faces() const { return *faces_; }

 private:
  const ObjectModel* model_;
  VisibilityOptions options_;
  std::shared_ptr<const TriangleBvh> faces_;
  double tolerance_m_;
  bool is_solid_ = false;  // an edge is between two faces
  std::vector<int> all_lines_;
};

}  // namespace evpose
