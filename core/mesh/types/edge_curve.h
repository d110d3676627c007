// SPDX-License-Identifier: Apache-2.0

// Edges of a surface that may produce events, as curves (core/mesh/README.md).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

namespace evpose {

enum class EdgeKind : uint8_t {
  kCrease,    // the surface turns there
  kBoundary,  // the surface ends there
  kPainted,   // a line or the edge of a colour that is drawn on the surface
  kContour,   // the surface turns away from the camera; depends on the view
};

// A chain of edges of one kind between corners, or a ring. Straight edges are ModelLines instead.
struct EdgeCurve {
  EdgeKind kind = EdgeKind::kCrease;
  std::vector<Eigen::Vector3d> points;  // at least two, object frame, metres; the first one again at the end of a ring
  // The outward unit normals of the faces beside each segment between successive points. The second is zero where there
  // is one face, as on a boundary or for a painted curve; both are zero for a wire.
  std::vector<std::array<Eigen::Vector3d, 2>> face_normals;
  // Median angle by which the surface turns at the curve, rad; 0 unless the kind is kCrease.
  double turn_rad = 0.0;

  bool is_ring() const { return points.size() > 2 && points.front() == points.back(); }
};

}  // namespace evpose
