// SPDX-License-Identifier: Apache-2.0

// Bounding volume hierarchy over triangles, for occlusion and for the faces near a point.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"

namespace evpose {

class TriangleBvh {
 public:
  // Keeps no reference to the arguments. Indices must be in range, and triangles must have an area.
  TriangleBvh(absl::Span<const Eigen::Vector3d> vertices, absl::Span<const std::array<uint32_t, 3>> triangles);

  bool empty() const { return triangles_.empty(); }

  // Whether a triangle, seen from either side, is between origin and point. A triangle whose plane is within
  // `plane_tolerance_m` of the point does not count: the point is on it, even in a grazing view. (Moller and Trumbore,
  // "Fast, minimum storage ray/triangle intersection", 1997.)
  bool IsOccluded(const Eigen::Vector3d& origin, const Eigen::Vector3d& point, double plane_tolerance_m) const;

  struct Near {
    double distance_m = 0.0;
    Eigen::Vector3d normal;  // unit
  };
  // Replaces `found` by the triangles within `radius_m` of a point, in an order that depends on the mesh only.
  void FindNear(const Eigen::Vector3d& point, double radius_m, std::vector<Near>& found) const;
  // Whether one of them has a normal with at least that cosine to `direction`. Ends at the first.
  bool HasNear(const Eigen::Vector3d& point, double radius_m, const Eigen::Vector3d& direction,
               double min_cosine) const;

 private:
  struct Triangle {
    Eigen::Vector3d corner;
    Eigen::Vector3d edge1, edge2;  // to the other two corners
    Eigen::Vector3d normal;        // unit
  };
  struct Node {
    Eigen::AlignedBox3d box;
    uint32_t first = 0;  // leaf: first triangle; else: right child (the left one follows its parent)
    uint32_t count = 0;  // leaf: number of triangles; else 0
  };

  struct Mesh {
    absl::Span<const Eigen::Vector3d> vertices;
    absl::Span<const std::array<uint32_t, 3>> triangles;
  };
  // Calls `visit` with each triangle within the radius and its squared distance, until it returns true.
  template <typename Visit>
  void VisitNear(const Eigen::Vector3d& point, double radius_m, const Visit& visit) const;
  // Appends the tree of these triangles and reorders the span.
  void Build(const Mesh& mesh, absl::Span<uint32_t> triangles);

  std::vector<Triangle> triangles_;  // in leaf order
  std::vector<Node> nodes_;          // depth first
};

}  // namespace evpose
