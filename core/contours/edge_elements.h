// SPDX-License-Identifier: Apache-2.0

// Edge elements: the short straight pieces of creases, boundaries, painted lines and occluding contours that a camera
// sees (core/contours/README.md).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/mesh/triangle_bvh.h"
#include "core/mesh/types/edge_curve.h"
#include "core/models/object_model.h"

namespace evpose {

// Prior contrast of a step between parallel faces (core/contours/README.md, section 4).
inline constexpr float kStepContrast = 0.1f;
// Prior contrast of a crease of at least 40 degrees that is no part of the outline.
inline constexpr float kSharpCreaseContrast = 0.8f;
// Returns the prior contrast of a crease that turns by `turn_rad` and is no part of the outline.
float CreaseContrast(double turn_rad);

struct EdgeElement {
  Eigen::Vector3d p1;  // object frame, metres
  Eigen::Vector3d p2;
  // Contour: the outward unit normals of the surface at p1 and p2. Other kinds: those of the adjacent faces, as in
  // EdgeCurve::face_normals.
  std::array<Eigen::Vector3d, 2> normals = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  // Contour: radius of curvature, metres, of the normal section of the surface along the ray through p1 and p2. 0: the
  // element is fixed to the object.
  std::array<double, 2> radius_m = {0.0, 0.0};
  // Contour between facets of the object, which is fixed to it: the number of the edge in ObjectModel::facet_edges in
  // the middle of the element. kNoFacetEdge: another element.
  static constexpr uint32_t kNoFacetEdge = ~0u;
  uint32_t facet_edge = kNoFacetEdge;
  // Identifies the edge curve across views; what the tracker learns over time is kept per curve. Below
  // model.lines.size(): a straight line of the model; then its curves; then arcs of contours, one number for each
  // curved region and octant of the image normal.
  uint32_t curve = 0;
  EdgeKind kind = EdgeKind::kCrease;
  float prior_contrast = 1.0f;  // expected log contrast relative to that of an occluding contour, in (0, 1]
};

// sagitta_px is validated by contours_test (errors of elements against the true surface), min_chain_px by creases_test,
// max_arc_px by element_arcs_test, and all fields together, with the processor time, by `evpose bench models`
// (core/experiments/RESULTS.md, Tracking).
struct EdgeElementOptions {
  // Largest distance, pixels, between a curve and the chord that replaces it. A quarter of a pixel is below the
  // standard deviation of events about an edge.
  double sagitta_px = 0.25;
  // Chains of edges that are shorter in the image, pixels, are not used: they have few events.
  double min_chain_px = 3.0;
  // Most elements of a view. The time of a window grows with their number; with fewer, a detailed object would lose
  // edges that determine its pose.
  int max_elements = 256;
  // Successive elements of a curve are tracked as one arc of at most this length, pixels (core/association/README.md,
  // section 5); 0: each by itself. The cost of a window is proportional to the number of arcs; with 48 px they have two
  // to four elements.
  double max_arc_px = 48.0;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// The level of detail of curves: the size of a pixel at the object relative to the diameter of the object in steps of
// 1.5, from 0 (finest, an object 3000 pixels wide) to kNumDetailLevels - 1. `previous` is the level in use: it is kept
// until the size differs by 10 % more than the step. Negative: none.
inline constexpr int kNumDetailLevels = 16;
int DetailLevel(const ObjectModel& model, const CameraModel& camera, const RigidTransform& camera_from_object,
                int previous);

class CurveLevels;     // curve_levels.h
struct SurfaceTables;  // surface_tables.h

// Finds the visible edge elements of a model. Immutable after construction, thread-compatible. Keeps a reference:
// `model` must outlive it.
class EdgeElementExtractor {
 public:
  EdgeElementExtractor(const ObjectModel& model, std::shared_ptr<const SurfaceTables> surface,
                       const EdgeElementOptions& options);
  // Makes tables of its own. `faces`, the search tree of the model's triangles, must outlive it.
  EdgeElementExtractor(const ObjectModel& model, const TriangleBvh& faces, const EdgeElementOptions& options);
  ~EdgeElementExtractor();
  EdgeElementExtractor(const EdgeElementExtractor&) = delete;
  EdgeElementExtractor& operator=(const EdgeElementExtractor&) = delete;

  const EdgeElementOptions& options() const { return options_; }
  // Whether the model has edges in addition to its straight lines: curves, or curved regions or facets with contours.
  bool has_curves() const;
  // Upper bound of EdgeElement::curve.
  uint32_t num_curves() const;
  // Replaces `elements` by those of the model's curves and contours that are visible at the pose, at a level of detail;
  // its straight lines are not included (core/models/visibility.h). A pure function of the arguments; the order is that
  // of the curves and of the points along each. Returns whether `max_elements` excludes some: the view then has edges
  // without an element.
  bool Extract(const CameraModel& camera, const RigidTransform& camera_from_object, int level,
               std::vector<EdgeElement>& elements) const;
  // Distance, pixels, by which the contour has left an element between facets since both facets face the camera centre
  // `eye` (object frame), or both are turned away. The element is then no contour (core/contours/README.md, equation
  // (11)). 0 for other elements.
  double FacetShiftPx(const EdgeElement& element, const Eigen::Vector3d& eye, double focal_px) const;

 private:
  const ObjectModel& model_;
  const std::shared_ptr<const SurfaceTables> surface_;
  const EdgeElementOptions options_;
  const std::unique_ptr<const CurveLevels> curves_;
};

// Moves the ends of a contour element along the surface to where the surface turns away from the camera centre `eye`
// (object frame), with the radius of curvature along the ray (core/contours/README.md, equation (6)). The result is
// exact for spheres; else its error is of third order in the change of the view. The errors of successive calls add up:
// slide a copy of the element that was extracted. Elements that are fixed to the object stay.
void SlideContour(const Eigen::Vector3d& eye, EdgeElement& element);

}  // namespace evpose
