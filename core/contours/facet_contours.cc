// SPDX-License-Identifier: Apache-2.0
#include "core/contours/facet_contours.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include "core/base/yield_point.h"

namespace evpose {

FacetContours::FacetContours(const ObjectModel& model) : model_(model) {
  if (empty()) return;
  for (const auto& [i, j, k] : model.triangles) {
    const Eigen::Vector3d& point = model.vertices[i];
    const Eigen::Vector3d normal = (model.vertices[j] - point).cross(model.vertices[k] - point).normalized();
    for (int axis = 0; axis < 3; ++axis) normals_[axis].push_back(normal[axis]);
    heights_m_.push_back(normal.dot(point));
  }
}

std::vector<FacetContours::ContourEdge> FacetContours::FindEdges(const Eigen::Vector3d& eye) const {
  std::vector<double> heights_m = heights_m_;
  std::vector<uint8_t> is_back(heights_m.size());
  SubtractEye(normals_[0].data(), normals_[1].data(), normals_[2].data(), eye, heights_m.size(), heights_m.data(),
              is_back.data());
  std::vector<ContourEdge> edges;
  for (uint32_t e = 0; e < model_.facet_edges.size(); ++e) {
    const auto& [first, second] = model_.facet_edges[e];
    if (is_back[first / 3] == is_back[second / 3]) continue;
    const uint32_t front = is_back[first / 3] ? second : first;
    edges.push_back({VertexOf(front), VertexOf(front / 3 * 3 + (front + 1) % 3), e, 0, false});
  }
  std::sort(edges.begin(), edges.end(), [](const ContourEdge& a, const ContourEdge& b) {
    return std::tie(a.begin, a.edge) < std::tie(b.begin, b.edge);
  });
  return edges;
}

FacetContours::ContourEdge* FacetContours::NextOf(const ContourEdge& edge, std::vector<ContourEdge>& edges) {
  const auto first = std::lower_bound(edges.begin(), edges.end(), edge.end,
                                      [](const ContourEdge& e, uint32_t vertex) { return e.begin < vertex; });
  if (first == edges.end() || first->begin != edge.end) return nullptr;
  // Not from the first one again: many contours may meet at one vertex.
  auto next = first + first->num_visited;
  while (next != edges.end() && next->begin == edge.end && next->is_visited) {
    ++next;
    ++first->num_visited;
  }
  return next != edges.end() && next->begin == edge.end ? &*next : nullptr;
}

void FacetContours::FollowEdges(std::vector<ContourEdge>& edges, size_t first, const Eigen::Vector3d& eye,
                                uint32_t region, Rims& rims) const {
  const auto begin = static_cast<uint32_t>(rims.points.size());
  rims.points.push_back({model_.vertices[edges[first].begin], Eigen::Vector3d::Zero(), 0.0, edges[first].edge});
  for (ContourEdge* edge = &edges[first]; edge != nullptr;) {
    edge->is_visited = true;
    RimPoint& from = rims.points.back();
    from.facet_edge = edge->edge;
    RimPoint to{model_.vertices[edge->end], Eigen::Vector3d::Zero(), 0.0, edge->edge};
    // The normal of the plane through the eye and the edge, outward; at a vertex the mean of both edges.
    Eigen::Vector3d normal = (to.point - from.point).cross(from.point - eye).normalized();
    const auto& [one, other] = model_.facet_edges[edge->edge];
    if (normal.dot(NormalOf(one / 3) + NormalOf(other / 3)) < 0.0) normal = -normal;
    from.normal += normal;
    to.normal += normal;
    rims.points.push_back(to);
    edge = NextOf(*edge, edges);
  }
  const auto end = static_cast<uint32_t>(rims.points.size());
  RimPoint& last = rims.points.back();
  const bool is_ring = last.point == rims.points[begin].point;
  if (is_ring) {
    last.normal += rims.points[begin].normal;
    rims.points[begin].normal = last.normal;
  }
  for (uint32_t i = begin; i < end; ++i) rims.points[i].normal.normalize();
  rims.chains.push_back({region, begin, end, is_ring, true});
}

void FacetContours::AppendRims(const Eigen::Vector3d& eye, uint32_t region, Rims& rims) const {
  if (empty()) return;
  std::vector<ContourEdge> edges = FindEdges(eye);
  std::vector<uint32_t> ends;
  for (const ContourEdge& edge : edges) ends.push_back(edge.end);
  std::sort(ends.begin(), ends.end());
  // Contours that end at a crease first, from their beginning; what remains are rings.
  for (const bool is_open : {true, false}) {
    for (size_t i = 0; i < edges.size(); ++i) {
      YieldPoint(i);
      if (edges[i].is_visited) continue;
      if (is_open && std::binary_search(ends.begin(), ends.end(), edges[i].begin)) continue;
      FollowEdges(edges, i, eye, region, rims);
    }
  }
}

double FacetContours::ShiftPx(uint32_t edge, const Eigen::Vector3d& eye, double focal_px) const {
  double least_px = std::numeric_limits<double>::infinity();
  int num_back = 0;
  for (const uint32_t side : model_.facet_edges[edge]) {
    const auto corner = [&](uint32_t offset) -> const Eigen::Vector3d& {
      return model_.vertices[VertexOf(side / 3 * 3 + (side + offset) % 3)];
    };
    const Eigen::Vector3d along = corner(1) - corner(0);
    const Eigen::Vector3d to_eye = eye - corner(0);
    const double height_m = NormalOf(side / 3).dot(to_eye);
    if (height_m <= 0.0) ++num_back;
    const double width_m = along.cross(corner(2) - corner(0)).norm() / along.norm();
    least_px = std::min(least_px, focal_px * width_m * std::abs(height_m) / to_eye.squaredNorm());
  }
  return num_back == 1 ? 0.0 : least_px;
}

}  // namespace evpose
