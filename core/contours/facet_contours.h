// SPDX-License-Identifier: Apache-2.0

// Occluding contours of an object that has the facets of its mesh: edges between a facet that faces the camera and one
// that does not (core/contours/README.md, section 3).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "core/contours/contour_mesh.h"
#include "core/models/object_model.h"

namespace evpose {

// Immutable after construction. Keeps a reference: `model` must outlive it.
class FacetContours {
 public:
  explicit FacetContours(const ObjectModel& model);

  bool empty() const { return model_.facet_edges.empty(); }
  // Appends the contours for the camera centre `eye`, each as the vertices along it. `region` is the number of their
  // region. The order is that of the vertices at which contours begin.
  void AppendRims(const Eigen::Vector3d& eye, uint32_t region, Rims& rims) const;
  // EdgeElementExtractor::FacetShiftPx for the edge with this number.
  double ShiftPx(uint32_t edge, const Eigen::Vector3d& eye, double focal_px) const;

 private:
  // An edge in the direction in which the facet that faces the eye is on its left, seen from outside.
  struct ContourEdge {
    uint32_t begin;  // vertices
    uint32_t end;
    uint32_t edge;
    uint32_t num_visited;  // only for the first edge that begins at a vertex: those from it on that are visited
    bool is_visited;
  };

  std::vector<ContourEdge> FindEdges(const Eigen::Vector3d& eye) const;
  // The first edge that begins where `edge` ends and is not visited; null if there is none.
  static ContourEdge* NextOf(const ContourEdge& edge, std::vector<ContourEdge>& edges);
  // Appends the chain of the successors of edges[first].
  void FollowEdges(std::vector<ContourEdge>& edges, size_t first, const Eigen::Vector3d& eye, uint32_t region,
                   Rims& rims) const;
  uint32_t VertexOf(uint32_t corner) const { return model_.triangles[corner / 3][corner % 3]; }
  Eigen::Vector3d NormalOf(uint32_t triangle) const {
    return {normals_[0][triangle], normals_[1][triangle], normals_[2][triangle]};
  }

  const ObjectModel& model_;
  std::array<std::vector<double>, 3> normals_;  // normals of the triangles, by coordinate
  std::vector<double> heights_m_;               // normal . point
};

}  // namespace evpose
