// SPDX-License-Identifier: Apache-2.0

// The triangles of a mesh as a surface: normals, neighbours, and paths that cross triangles (core/mesh/README.md,
// section 8).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/container/inlined_vector.h"
#include "absl/functional/function_ref.h"
#include "absl/types/span.h"
#include "core/mesh/mesh_edges.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose {

// Angle between two vectors, rad, in [0, pi]; 0 if one is zero.
double AngleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b);

// Unit vector perpendicular to an edge, in the plane of one of its faces and towards its inside.
Eigen::Vector3d WingOf(const RawMesh& mesh, const EdgeUse& use);

// Side `s` of triangle `t`, from its corner s to the next one, has the number 3 t + s. Keeps a reference: `mesh` must
// outlive it. Vertices must be shared, and triangles must have an area.
class FacetGraph {
 public:
  static constexpr uint32_t kNone = ~0u;

  explicit FacetGraph(const RawMesh& mesh);

  const RawMesh& mesh() const { return mesh_; }
  const std::vector<EdgeUse>& uses() const { return uses_; }
  // Unit; of the triangle's plane.
  const Eigen::Vector3d& normal(uint32_t triangle) const { return normals_[triangle]; }
  // The side of the neighbour at the same edge, if exactly two triangles with one winding meet there, unless they
  // belong to bodies that touch there (core/mesh/README.md, section 6). The same for an edge within a sheet with two
  // sides; else kNone.
  uint32_t opposite(uint32_t side) const { return opposite_[side]; }
  // Angle, rad, by which the surface turns there, positive if it is convex; 0 without a neighbour.
  double turn_rad(uint32_t side) const { return turn_rad_[side]; }

  const Eigen::Vector3d& begin(uint32_t side) const { return mesh_.points[mesh_.triangles[side / 3][side % 3]]; }
  const Eigen::Vector3d& end(uint32_t side) const { return mesh_.points[mesh_.triangles[side / 3][(side + 1) % 3]]; }
  // Unit vector from begin to end.
  Eigen::Vector3d Along(uint32_t side) const { return (end(side) - begin(side)).normalized(); }
  // Unit vector perpendicular to the side, in the plane of its triangle and into it.
  Eigen::Vector3d Into(uint32_t side) const { return normals_[side / 3].cross(Along(side)); }

 private:
  // Pairs of the triangles at an edge that are neighbours.
  absl::InlinedVector<std::array<EdgeUse, 2>, 2> NeighboursAt(absl::Span<const EdgeUse> uses) const;
  void SetNeighbours(const std::array<EdgeUse, 2>& pair);

  const RawMesh& mesh_;
  const std::vector<EdgeUse> uses_;
  std::vector<Eigen::Vector3d> normals_;
  std::vector<uint32_t> opposite_;
  std::vector<float> turn_rad_;
};

// The part of a path inside one triangle.
struct PathStep {
  uint32_t triangle = 0;
  double from_m = 0.0;  // length of the path up to this triangle
  double to_m = 0.0;
  uint32_t exit = 0;  // side at which the path leaves the triangle
};

// Follows the path that begins at the middle of a side, perpendicular to it, and is straight when the triangles that it
// crosses are unfolded into a plane. Ends at the given length, where a side has no opposite, after 96 triangles, when
// `visit` returns false, and when `work`, from which one is subtracted for each triangle, is 0.
void WalkAcross(const FacetGraph& graph, uint32_t side, double max_length_m, int64_t& work,
                absl::FunctionRef<bool(const PathStep& step)> visit);

}  // namespace evpose
