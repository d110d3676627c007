// SPDX-License-Identifier: Apache-2.0

// What the baselines with known correspondences are given, and the linear and least-squares steps that several share.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// A segment and the model line that it is a part of: only the line counts, the end points do not correspond.
struct LineMatch {
  Eigen::Vector3d p1;  // object frame, metres
  Eigen::Vector3d p2;
  ImageSegment segment;
};

// The least-squares solution of n_j . (R P + T) = 0 for both end points P of each line (LOPET, Sec. III-B): with an
// exact rotation both say the same, with another one their mean counts. Lines weigh by their segments' lengths, to
// which the noise of a normal is inverse. nullopt when the normals do not fix T.
std::optional<Eigen::Vector3d> SolveTranslation(absl::Span<const LineMatch> matches, const CameraModel& camera,
                                                const Eigen::Matrix3d& rotation);

// Gauss-Newton on the distances of the segments' end points from their projected lines, pixels. nullopt when a line
// leaves the space in front of the camera or the lines do not fix the pose.
std::optional<RigidTransform> RefinePose(absl::Span<const LineMatch> matches, const CameraModel& camera,
                                         const RigidTransform& start, int max_iterations);

// Root mean square of those distances; infinite when a line lies behind the camera.
double LineResidualPx(absl::Span<const LineMatch> matches, const CameraModel& camera, const RigidTransform& pose);

// (x, y, 1) of an undistorted pixel.
Eigen::Vector3d BearingOfPixel(const CameraModel& camera, const Eigen::Vector2d& pixel);

}  // namespace evpose
