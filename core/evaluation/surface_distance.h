// SPDX-License-Identifier: Apache-2.0

// How far the surface of an object at one pose is from that at another one: an error that needs no list of symmetries
// (core/evaluation/README.md, section 1).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/geometry/rigid_transform.h"
#include "core/mesh/triangle_bvh.h"
#include "core/models/object_model.h"

namespace evpose {

class SurfaceDistance {
 public:
  // The model must have triangles, and is not kept.
  explicit SurfaceDistance(const ObjectModel& model);

  // Mean distance, metres, of points of the surface at the estimated pose from the surface at the true pose: 0 for
  // poses that look the same, and at most the distance of the same points at both poses.
  double Between(const RigidTransform& true_pose, const RigidTransform& estimated_pose) const;

 private:
  double DistanceOf(const Eigen::Vector3d& point_object, std::vector<TriangleBvh::Near>& found) const;

  const TriangleBvh faces_;
  const double diameter_m_;
  std::vector<Eigen::Vector3d> samples_;  // object frame, spread evenly over the area
};

}  // namespace evpose
