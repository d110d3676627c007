// SPDX-License-Identifier: Apache-2.0
#include "core/models/model_lines.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/counted.h"
#include "core/mesh/mesh_topology.h"
#include "core/models/collinear_lines.h"

namespace evpose {
namespace {

// Edges that turn by less than this (rad) continue each other. Single precision causes turns of 1e-4 at edges of a
// thousandth of the model's size; a polygon of 1000 corners turns by 6e-3 at each.
constexpr double kCollinearAngle = 2e-3;
// Faces of edges that are joined are the same if their normals have at least this cosine (1 degree): slivers have
// inaccurate normals.
constexpr double kSameFaceCosine = 0.99985;

struct Edge {
  std::array<uint32_t, 2> ends;
  std::vector<Eigen::Vector3d> normals;
  EdgeKind kind;
};

void AddDistinct(const Eigen::Vector3d& normal, std::vector<Eigen::Vector3d>& normals) {
  if (normals.size() >= kMaxFaceNormals) return;
  if (!ContainsNormal(normal, normals, kSameNormalCosine)) normals.push_back(normal);
}

Eigen::Vector3d Normal(const RawMesh& model, uint32_t triangle) {
  const auto& [i, j, k] = model.triangles[triangle];
  return (model.points[j] - model.points[i]).cross(model.points[k] - model.points[i]).normalized();
}

// Joins edges that continue each other: links their ends, follows the chains and cuts them into straight parts.
class EdgeJoiner {
 public:
  EdgeJoiner(const RawMesh& model, const std::vector<Edge>& edges, double tolerance_m)
      : model_(model), edges_(edges), tolerance_m_(tolerance_m), links_(edges.size(), {kNone, kNone}) {}

  std::vector<ModelLine> Join() {
    LinkEnds();
    std::vector<ModelLine> lines;
    visited_.assign(edges_.size(), false);
    // First the chains that have an end; the rest are rings of many short edges, which begin at their first edge.
    for (const bool from_ends : {true, false}) {
      for (uint32_t e = 0; e < edges_.size(); ++e) {
        if (visited_[e]) continue;
        const int free_end = links_[e][0] == kNone ? 0 : 1;
        if (from_ends && links_[e][free_end] != kNone) continue;
        WalkChain(e, free_end, lines);
      }
    }
    return lines;
  }

 private:
  static constexpr uint32_t kNone = ~0u;

  struct End {
    uint32_t vertex;
    uint32_t edge;
    uint8_t which;  // 0 or 1
  };

  // Unit vector from that end into the edge.
  Eigen::Vector3d Direction(const End& end) const {
    const auto& ends = edges_[end.edge].ends;
    return (model_.points[ends[1 - end.which]] - model_.points[ends[end.which]]).normalized();
  }

  bool HaveSameFaces(const Edge& a, const Edge& b) const {
    return a.normals.size() == b.normals.size() &&
           std::all_of(a.normals.begin(), a.normals.end(),
                       [&](const Eigen::Vector3d& n) { return ContainsNormal(n, b.normals, kSameFaceCosine); });
  }

  void LinkEnds() {
    std::vector<End> ends;
    for (uint32_t e = 0; e < edges_.size(); ++e) {
      for (uint8_t which = 0; which < 2; ++which) ends.push_back({edges_[e].ends[which], e, which});
    }
    std::sort(ends.begin(), ends.end(), [](const End& a, const End& b) {
      return std::tie(a.vertex, a.edge, a.which) < std::tie(b.vertex, b.edge, b.which);
    });
    for (size_t begin = 0; begin < ends.size();) {
      size_t end = begin + 1;
      while (end < ends.size() && ends[end].vertex == ends[begin].vertex) ++end;
      LinkAtVertex(absl::MakeConstSpan(ends).subspan(begin, end - begin));
      begin = end;
    }
  }

  void LinkAtVertex(absl::Span<const End> ends) {
    // All pairs of more ends would take too long, and hardly any edges of a large fan continue each other.
    constexpr size_t kMaxEnds = 64;
    if (ends.size() > kMaxEnds) return;
    for (size_t i = 0; i < ends.size(); ++i) {
      for (size_t j = i + 1; j < ends.size(); ++j) {
        uint32_t& link_i = links_[ends[i].edge][ends[i].which];
        uint32_t& link_j = links_[ends[j].edge][ends[j].which];
        if (link_i != kNone || link_j != kNone) continue;
        const Eigen::Vector3d direction_i = Direction(ends[i]), direction_j = Direction(ends[j]);
        const bool continues =
            direction_i.dot(direction_j) < 0.0 && direction_i.cross(direction_j).norm() < kCollinearAngle;
        if (!continues || !HaveSameFaces(edges_[ends[i].edge], edges_[ends[j].edge])) continue;
        link_i = ends[j].edge;
        link_j = ends[i].edge;
      }
    }
  }

  void WalkChain(uint32_t first, int free_end, std::vector<ModelLine>& lines) {
    chain_edges_.clear();
    chain_vertices_.assign(1, edges_[first].ends[free_end]);
    for (uint32_t edge = first; edge != kNone && !visited_[edge];) {
      visited_[edge] = true;
      chain_edges_.push_back(edge);
      const int far_end = edges_[edge].ends[0] == chain_vertices_.back() ? 1 : 0;
      chain_vertices_.push_back(edges_[edge].ends[far_end]);
      edge = links_[edge][far_end];
    }
    SplitChain(lines);
  }

  // Appends the chain as one line if it is straight; else cuts it at the farthest vertex and repeats this for the parts
  // (Douglas and Peucker, 1973).
  void SplitChain(std::vector<ModelLine>& lines) {
    // Cuts near the ends of all parts would take quadratic time. A chain that has taken as much as this is cut in the
    // middle of its parts; ordinary ones take some log2(n) distances per vertex.
    constexpr size_t kDistancesPerVertex = 64;
    size_t distances_left = kDistancesPerVertex * chain_vertices_.size();
    std::vector<std::pair<size_t, size_t>> parts = {{0, chain_vertices_.size() - 1}};
    while (!parts.empty()) {
      const auto [begin, end] = parts.back();
      parts.pop_back();
      const Eigen::Vector3d& p1 = model_.points[chain_vertices_[begin]];
      const Eigen::Vector3d& p2 = model_.points[chain_vertices_[end]];
      const Eigen::Vector3d direction = (p2 - p1).normalized();
      double farthest_m = tolerance_m_;
      size_t cut = begin;
      for (size_t i = begin + 1; i < end; ++i) {
        const double distance_m = (model_.points[chain_vertices_[i]] - p1).cross(direction).norm();
        if (distance_m <= farthest_m) continue;
        farthest_m = distance_m;
        cut = i;
      }
      // The two ends of a ring are one point and give no direction: it is cut in the middle.
      const bool is_expensive = distances_left < end - begin;
      distances_left -= is_expensive ? 0 : end - begin;
      if (chain_vertices_[begin] == chain_vertices_[end] || (is_expensive && cut != begin)) {
        cut = begin + (end - begin) / 2;
      }
      if (cut == begin) {
        const Edge& middle = edges_[chain_edges_[(begin + end) / 2]];
        lines.push_back({p1, p2, middle.normals, middle.kind});
        continue;
      }
      parts.push_back({cut, end});
      parts.push_back({begin, cut});
    }
  }

  const RawMesh& model_;
  const std::vector<Edge>& edges_;
  const double tolerance_m_;
  std::vector<std::array<uint32_t, 2>> links_;  // for both ends of each edge, the edge that continues it
  std::vector<bool> visited_;
  std::vector<uint32_t> chain_vertices_;
  std::vector<uint32_t> chain_edges_;
};

// Adds the normals of the faces nearest to one point of a line. Returns the number of faces that were considered.
int64_t AddNormalsAt(const Eigen::Vector3d& point, const Eigen::Vector3d& direction, const TriangleBvh& faces,
                     double diameter_m, std::vector<TriangleBvh::Near>& found, std::vector<Eigen::Vector3d>& normals) {
  // Relative to the diameter. A line may be drawn a little above its face; the other side of a thin plate, which is at
  // another distance, does not belong to it.
  constexpr double kSurfaceTolerance = 1e-3, kSameDistance = 1e-5;
  // Sine of 2 degrees: steeper lines pierce the face.
  constexpr double kMaxSlope = 0.035;
  faces.FindNear(point, kSurfaceTolerance * diameter_m, found);
  const auto num_found = static_cast<int64_t>(found.size());
  std::erase_if(found, [&](const TriangleBvh::Near& near) { return std::abs(near.normal.dot(direction)) > kMaxSlope; });
  double nearest_m = kSurfaceTolerance * diameter_m;
  for (const TriangleBvh::Near& near : found) nearest_m = std::min(nearest_m, near.distance_m);
  for (const TriangleBvh::Near& near : found) {
    if (near.distance_m <= nearest_m + kSameDistance * diameter_m) AddDistinct(near.normal, normals);
  }
  return num_found;
}

}  // namespace

std::vector<ModelLine> StraightLines(const RawMesh& mesh, absl::Span<const MeshEdge> mesh_edges) {
  std::vector<Edge> edges;
  edges.reserve(mesh_edges.size());
  for (const MeshEdge& mesh_edge : mesh_edges) {
    Edge edge{mesh_edge.ends, {}, mesh_edge.kind};
    for (const uint32_t triangle : mesh_edge.triangles) AddDistinct(Normal(mesh, triangle), edge.normals);
    edges.push_back(std::move(edge));
  }
  return EdgeJoiner(mesh, edges, kCollinearTolerance * BoundingBoxDiagonal(mesh)).Join();
}

std::vector<ModelLine> PaintedLines(const RawMesh& mesh, const TriangleBvh& faces, double diameter_m,
                                    std::vector<std::string>& notices, int64_t max_faces) {
  // Shares of the line at which faces are searched, irregular and away from the ends, where other faces begin. A face
  // counts if it is found at two of them: a line that crosses another face meets it at one.
  constexpr double kSamples[] = {0.13, 0.31, 0.5, 0.71, 0.87};
  constexpr int kMinSamples = 2;
  std::vector<ModelLine> lines;
  std::vector<TriangleBvh::Near> found;
  std::vector<std::pair<Eigen::Vector3d, int>> counted;
  int64_t num_faces = 0;
  size_t num_unsearched = 0;
  for (const auto& [i, j] : mesh.lines) {
    ModelLine line{mesh.points[i], mesh.points[j], {}, EdgeKind::kPainted};
    counted.clear();
    if (num_faces > max_faces) ++num_unsearched;
    for (const double sample : kSamples) {
      if (num_faces > max_faces) break;
      std::vector<Eigen::Vector3d> here;
      num_faces += 1 + AddNormalsAt(line.p1 + sample * (line.p2 - line.p1), (line.p2 - line.p1).normalized(), faces,
                                    diameter_m, found, here);
      for (const Eigen::Vector3d& normal : here) {
        const auto same = std::find_if(counted.begin(), counted.end(),
                                       [&](const auto& entry) { return entry.first.dot(normal) > kSameNormalCosine; });
        if (same == counted.end()) {
          counted.push_back({normal, 1});
        } else {
          ++same->second;
        }
      }
    }
    for (const auto& [normal, count] : counted) {
      if (count >= kMinSamples) line.face_normals.push_back(normal);
    }
    // A line along an edge of the mesh is that edge.
    if (line.face_normals.size() > 1) line.kind = EdgeKind::kCrease;
    lines.push_back(std::move(line));
  }
  if (num_unsearched > 0) {
    notices.push_back(
        absl::StrCat("the faces of ", Counted(num_unsearched, "line"), " were not searched: too many are near lines"));
  }
  return lines;
}

}  // namespace evpose
