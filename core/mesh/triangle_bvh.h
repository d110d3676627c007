// SPDX-License-Identifier: Apache-2.0

// Bounding volume hierarchy over triangles, for occlusion and for the faces near a point.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <optional>
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
  // The same result. The leaf `hint` is tested first, and replaced by the one that occludes: neighbouring points are
  // often hidden by the same triangles. Any number is allowed.
  bool IsOccluded(const Eigen::Vector3d& origin, const Eigen::Vector3d& point, double plane_tolerance_m,
                  uint32_t& hint) const;

  // Unit normal of the first triangle that the segment meets, on the side of the origin; nullopt if it meets none.
  std::optional<Eigen::Vector3d> FirstNormal(const Eigen::Vector3d& origin, const Eigen::Vector3d& end) const;

  struct Near {
    double distance_m = 0.0;
    Eigen::Vector3d normal;  // unit
  };
  // Replaces `found` by the triangles within `radius_m` of a point, in an order that depends on the mesh only.
  void FindNear(const Eigen::Vector3d& point, double radius_m, std::vector<Near>& found) const;
  // Whether one of them has a normal with at least that cosine to `direction`. Ends at the first.
  bool HasNear(const Eigen::Vector3d& point, double radius_m, const Eigen::Vector3d& direction,
               double min_cosine) const;
  // The same. The triangle `hint` is tested first, and replaced by the one that is found: neighbouring points are often
  // near the same triangle. Any number is allowed.
  bool HasNear(const Eigen::Vector3d& point, double radius_m, const Eigen::Vector3d& direction, double min_cosine,
               uint32_t& hint) const;

 private:
  struct Triangle {
    Eigen::Vector3d corner;
    Eigen::Vector3d edge1, edge2;  // to the other two corners
    Eigen::Vector3d normal;        // unit

    double SquaredDistance(const Eigen::Vector3d& point) const;
  };
  // Half a cache line. The boxes are relative to `centre_` and rounded outwards to single precision.
  struct Node {
    std::array<std::array<float, 3>, 2> bounds;  // least and greatest coordinates
    uint32_t first = 0;                          // leaf: index into `leaves_`; else: right child (the left one follows)
    uint32_t is_leaf = 0;
  };
  struct Leaf {
    Eigen::AlignedBox3d box;  // exact
    uint32_t first = 0;       // first triangle
    uint32_t count = 0;
  };
  struct Ray;

  struct Mesh {
    absl::Span<const Eigen::Vector3d> vertices;
    absl::Span<const std::array<uint32_t, 3>> triangles;
  };
  // A triangle to be sorted into the tree, with its centre times three, so that sorting reads memory in order.
  struct Entry {
    Eigen::Vector3d centre;
    uint32_t triangle;
  };
  // Calls `visit` with each triangle within the radius and its squared distance, until it returns true.
  template <typename Visit>
  void VisitNear(const Eigen::Vector3d& point, double radius_m, const Visit& visit) const;
  // Build() appends the nodes of the tree over `entries`, which it reorders, and AppendLeaf() appends one leaf. Both
  // require at least one entry and return the bounding box of the triangles.
  Eigen::AlignedBox3d Build(const Mesh& mesh, absl::Span<Entry> entries);
  Eigen::AlignedBox3d AppendLeaf(const Mesh& mesh, absl::Span<const Entry> entries);
  Node MakeNode(const Eigen::AlignedBox3d& box) const;
  // The least parameter in [0, `before`) at which the segment meets a triangle of the leaf, and the triangle.
  struct Meeting {
    double at = 0.0;
    uint32_t triangle = 0;
  };
  std::optional<Meeting> MeetLeaf(const Leaf& leaf, const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                                  double before) const;
  bool LeafOccludes(const Leaf& leaf, const Eigen::Vector3d& origin, const Eigen::Vector3d& point,
                    double plane_tolerance_m) const;

  std::vector<Triangle> triangles_;  // in leaf order
  std::vector<Node> nodes_;          // depth first
  std::vector<Leaf> leaves_;
  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();  // centre of the box of all triangles
  double extent_m_ = 0.0;                             // largest distance of a coordinate from the centre
};

}  // namespace evpose
