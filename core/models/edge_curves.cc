// SPDX-License-Identifier: Apache-2.0
#include "core/models/edge_curves.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstdint>
#include <utility>

#include "core/mesh/edge_chains.h"
#include "core/mesh/triangle_bvh.h"
#include "core/models/model_lines.h"

namespace evpose {
namespace {

// The normal of the surface in a triangle, at the middle of its side between two vertices.
Eigen::Vector3d NormalBeside(const RawMesh& mesh, const SmoothSurface& surface, uint32_t triangle,
                             const std::array<uint32_t, 2>& ends) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int corner = 0; corner < 3; ++corner) {
    const uint32_t vertex = mesh.triangles[triangle][corner];
    if (vertex == ends[0] || vertex == ends[1]) sum += surface.normals[triangle][corner].cast<double>();
  }
  return sum.normalized();
}

double MedianTurn(const EdgeChain& chain, absl::Span<const MeshEdge> edges) {
  std::vector<double> turns;
  for (const uint32_t edge : chain.edges) turns.push_back(edges[edge].turn_rad);
  const auto middle = turns.begin() + static_cast<std::ptrdiff_t>(turns.size() / 2);
  std::nth_element(turns.begin(), middle, turns.end());
  return *middle;
}

EdgeCurve CurveOf(const EdgeChain& chain, const RawMesh& mesh, const SurfaceEdges& edges) {
  EdgeCurve curve;
  curve.kind = edges.edges[chain.edges.front()].kind;
  for (const uint32_t vertex : chain.vertices) curve.points.push_back(mesh.points[vertex]);
  for (const uint32_t e : chain.edges) {
    const MeshEdge& edge = edges.edges[e];
    std::array<Eigen::Vector3d, 2> normals = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    for (size_t side = 0; side < std::min<size_t>(2, edge.triangles.size()); ++side) {
      normals[side] = NormalBeside(mesh, edges.surface, edge.triangles[side], edge.ends);
    }
    curve.face_normals.push_back(normals);
  }
  if (curve.kind == EdgeKind::kCrease) curve.turn_rad = MedianTurn(chain, edges.edges);
  return curve;
}

EdgeCurve PaintedCurveOf(const EdgeChain& chain, const RawMesh& mesh, absl::Span<const ModelLine> lines) {
  EdgeCurve curve;
  curve.kind = EdgeKind::kPainted;
  for (const uint32_t vertex : chain.vertices) curve.points.push_back(mesh.points[vertex]);
  for (const uint32_t e : chain.edges) {
    std::array<Eigen::Vector3d, 2> normals = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    for (size_t side = 0; side < std::min<size_t>(2, lines[e].face_normals.size()); ++side) {
      normals[side] = lines[e].face_normals[side];
    }
    curve.face_normals.push_back(normals);
  }
  return curve;
}

}  // namespace

void AddSurfaceEdges(const RawMesh& mesh, const SurfaceEdges& edges, ObjectModel& model) {
  std::vector<MeshEdge> straight;
  if (edges.surface.empty()) {
    straight = edges.edges;
  } else {
    std::vector<EdgeEnds> ends;
    for (const MeshEdge& edge : edges.edges) ends.push_back(edge.ends);
    const auto may_join = [&edges](uint32_t a, uint32_t b) {
      return edges.edges[a].kind == edges.edges[b].kind && edges.edges[a].triangles.size() <= 2 &&
             edges.edges[b].triangles.size() <= 2;
    };
    const CurvedParts curved = FindCurvedParts(mesh.points, ends, model.diameter_m, may_join);
    for (const EdgeChain& chain : curved.chains) model.curves.push_back(CurveOf(chain, mesh, edges));
    for (size_t e = 0; e < edges.edges.size(); ++e) {
      if (!curved.is_curved[e]) straight.push_back(edges.edges[e]);
    }
  }
  for (ModelLine& line : StraightLines(mesh, straight)) model.lines.push_back(std::move(line));
}

void AddPaintedEdges(const RawMesh& mesh, bool has_curves, ObjectModel& model) {
  std::vector<ModelLine> lines =
      PaintedLines(mesh, TriangleBvh(mesh.points, mesh.triangles), model.diameter_m, model.notices);
  CurvedParts curved;
  curved.is_curved.assign(lines.size(), false);
  if (has_curves) {
    curved = FindCurvedParts(mesh.points, mesh.lines, model.diameter_m, [](uint32_t, uint32_t) { return true; });
  }
  for (const EdgeChain& chain : curved.chains) model.curves.push_back(PaintedCurveOf(chain, mesh, lines));
  for (size_t e = 0; e < lines.size(); ++e) {
    if (!curved.is_curved[e]) model.lines.push_back(std::move(lines[e]));
  }
}

}  // namespace evpose
