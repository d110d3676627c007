// SPDX-License-Identifier: Apache-2.0
#include "core/models/edge_curves.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <utility>

#include "core/mesh/edge_chains.h"
#include "core/mesh/region_shapes.h"
#include "core/mesh/triangle_bvh.h"
#include "core/models/exact_curves.h"
#include "core/models/model_lines.h"
#include "core/models/smooth_curve.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Points that are inserted into all curves of one kind: bounds time and memory (15 MB). Curves of CAD models take some
// thousands.
constexpr size_t kMaxInsertedPoints = 200'000;

// The normal of the surface beside a point near an edge of a triangle: that of the shape of its region, or else between
// those at the ends of the edge.
Eigen::Vector3d NormalBeside(const RawMesh& mesh, const SmoothSurface& surface, uint32_t triangle,
                             const std::array<uint32_t, 2>& ends, const Eigen::Vector3d& point) {
  const Eigen::Vector3d exact = NormalOfShape(surface.regions[surface.region_of[triangle]], point);
  if (!exact.isZero()) return exact;
  const Eigen::Vector3d along = mesh.points[ends[1]] - mesh.points[ends[0]];
  const double position = std::clamp((point - mesh.points[ends[0]]).dot(along) / along.squaredNorm(), 0.0, 1.0);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int corner = 0; corner < 3; ++corner) {
    const uint32_t vertex = mesh.triangles[triangle][corner];
    if (vertex != ends[0] && vertex != ends[1]) continue;
    sum += (vertex == ends[1] ? position : 1.0 - position) * surface.normals[triangle][corner].cast<double>();
  }
  return sum.normalized();
}

// The points of the chain and those of the curve between them.
SmoothCurve CurveThrough(const EdgeChain& chain, const RawMesh& mesh, double diameter_m, size_t& max_inserted,
                         const std::optional<EdgeCircle>& circle = std::nullopt) {
  std::vector<Eigen::Vector3d> vertices;
  for (const uint32_t vertex : chain.vertices) vertices.push_back(mesh.points[vertex]);
  return SmoothChain(vertices, diameter_m, max_inserted, circle);
}

double MedianTurn(const EdgeChain& chain, absl::Span<const MeshEdge> edges) {
  std::vector<double> turns;
  for (const uint32_t edge : chain.edges) turns.push_back(edges[edge].turn_rad);
  return UpperMedian(turns);
}

EdgeCurve CurveOf(const EdgeChain& chain, SmoothCurve smooth, const RawMesh& mesh, const SurfaceEdges& edges) {
  EdgeCurve curve;
  curve.kind = edges.edges[chain.edges.front()].kind;
  for (size_t i = 0; i < smooth.chord_of.size(); ++i) {
    const MeshEdge& edge = edges.edges[chain.edges[smooth.chord_of[i]]];
    const Eigen::Vector3d middle = 0.5 * (smooth.points[i] + smooth.points[i + 1]);
    std::array<Eigen::Vector3d, 2> normals = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    for (size_t side = 0; side < std::min<size_t>(2, edge.triangles.size()); ++side) {
      normals[side] = NormalBeside(mesh, edges.surface, edge.triangles[side], edge.ends, middle);
    }
    curve.face_normals.push_back(normals);
  }
  curve.points = std::move(smooth.points);
  if (curve.kind == EdgeKind::kCrease) curve.turn_rad = MedianTurn(chain, edges.edges);
  return curve;
}

EdgeCurve PaintedCurveOf(const EdgeChain& chain, SmoothCurve smooth, absl::Span<const ModelLine> lines) {
  EdgeCurve curve;
  curve.kind = EdgeKind::kPainted;
  curve.points = std::move(smooth.points);
  for (const uint32_t chord : smooth.chord_of) {
    const ModelLine& line = lines[chain.edges[chord]];
    std::array<Eigen::Vector3d, 2> normals = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    for (size_t side = 0; side < std::min<size_t>(2, line.face_normals.size()); ++side) {
      normals[side] = line.face_normals[side];
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
    const ExactCurves exact = FindExactCurves(mesh, edges);
    size_t max_inserted = kMaxInsertedPoints;
    for (const auto& [chain, circle] : exact.curves) {
      model.curves.push_back(
          CurveOf(chain, CurveThrough(chain, mesh, model.diameter_m, max_inserted, circle), mesh, edges));
    }
    std::vector<uint32_t> others;
    std::vector<EdgeEnds> ends;  // ends of `others`
    for (uint32_t e = 0; e < edges.edges.size(); ++e) {
      if (exact.is_straight[e] || exact.is_curved[e]) continue;
      others.push_back(e);
      ends.push_back(edges.edges[e].ends);
    }
    const auto may_join = [&](uint32_t i, uint32_t k) {
      const MeshEdge &a = edges.edges[others[i]], &b = edges.edges[others[k]];
      return a.kind == b.kind && a.triangles.size() <= 2 && b.triangles.size() <= 2;
    };
    CurvedParts curved = FindCurvedParts(mesh.points, ends, model.diameter_m, may_join);
    for (EdgeChain& chain : curved.chains) {
      for (uint32_t& edge : chain.edges) edge = others[edge];
      model.curves.push_back(CurveOf(chain, CurveThrough(chain, mesh, model.diameter_m, max_inserted), mesh, edges));
    }
    std::vector<bool> is_curved = exact.is_curved;
    for (size_t i = 0; i < others.size(); ++i) is_curved[others[i]] = curved.is_curved[i];
    for (size_t e = 0; e < edges.edges.size(); ++e) {
      if (!is_curved[e]) straight.push_back(edges.edges[e]);
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
  size_t max_inserted = kMaxInsertedPoints;
  for (const EdgeChain& chain : curved.chains) {
    model.curves.push_back(PaintedCurveOf(chain, CurveThrough(chain, mesh, model.diameter_m, max_inserted), lines));
  }
  for (size_t e = 0; e < lines.size(); ++e) {
    if (!curved.is_curved[e]) model.lines.push_back(std::move(lines[e]));
  }
}

}  // namespace evpose
