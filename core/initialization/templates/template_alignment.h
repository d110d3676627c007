// SPDX-License-Identifier: Apache-2.0

// Aligns a pose with the edges of a distance map, scores it and estimates its twist
// (core/initialization/templates/README.md, sections 4 and 5).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/templates/edge_distance_map.h"
#include "core/initialization/templates/edge_samples.h"
#include "core/initialization/templates/twist_equations.h"

namespace evpose {

// How well the edges of an object at a pose agree with those in the map.
struct AlignmentScore {
  // Share of the samples with an edge of the map nearby, among those whose motion should cause events. Samples behind
  // the camera or outside the map count as samples that should cause events and have no edge nearby.
  double hit_ratio = 0.0;
  double explained_ratio = 0.0;  // share of the events on the edges of the map with a sample nearby

  // An edge without events costs less than events without an edge: edges of low contrast and those that move along
  // themselves have none.
  double total() const { return 0.5 * hit_ratio + explained_ratio; }
};

// Immutable after construction. Keeps a reference: `map` must outlive it.
class TemplateAligner {
 public:
  // `object_radius_m` scales the changes of the pose that are expected.
  TemplateAligner(const EdgeDistanceMap& map, const CameraModel& camera, double object_radius_m,
                  const Eigen::Vector3d& object_centre);

  const CameraModel& map_camera() const { return camera_; }

  // Moves the pose by Gauss-Newton steps so that the samples meet edges: the distances of the nearest edges up to
  // `gate` cells count, which shrinks to `last_gate`. Every `stride`-th sample is used.
  RigidTransform Align(RigidTransform camera_from_object, absl::Span<const EdgeSample> samples, double gate,
                       double last_gate, int iterations, size_t stride) const;
  // Mean nearness of the samples to edges of their directions, in [0, 1].
  double Nearness(const RigidTransform& camera_from_object, absl::Span<const EdgeSample> samples) const;
  // `twist` is the motion at the pose, and `duration_s` the time in which the edges of the map were seen.
  AlignmentScore Score(const RigidTransform& camera_from_object, absl::Span<const EdgeSample> samples,
                       const Vector6d& twist, double duration_s) const;
  // The twist that explains the motion of the edges near the samples.
  TwistEstimate EstimateTwist(const RigidTransform& camera_from_object, absl::Span<const EdgeSample> samples,
                              const TwistPrior& prior) const;

 private:
  // A sample in the map.
  struct Image {
    Eigen::Vector2d at;
    Eigen::Vector2d along;  // cells: half the distance of neighbouring samples
    Eigen::Vector3d arm;    // R P, metres
    Eigen::Vector3d point;  // camera frame
    int bin = 0;
    int x = 0;
    int y = 0;
  };
  // False if the sample is not in front of the camera, or outside the map.
  bool Project(const RigidTransform& camera_from_object, const EdgeSample& sample, Image& image) const;
  // Derivative of `normal` . image with respect to the pose, cells.
  Vector6d RowOf(const Image& image, const Eigen::Vector2d& normal) const;
  // Sets the bits of the sample's direction and its neighbours in the cells near its part of the edge.
  void Mark(const Image& image, std::vector<uint16_t>& directions) const;
  // The edge at the sample; null if it is farther than kReach.
  const MapEdge* EdgeAt(const Image& image) const;

  const EdgeDistanceMap& map_;
  const CameraModel camera_;  // its pixels are the cells of the map
  const double radius_m_;
  const Eigen::Vector3d centre_;
};

}  // namespace evpose
