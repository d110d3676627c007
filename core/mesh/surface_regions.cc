// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/surface_regions.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/types/span.h"
#include "core/mesh/corner_normals.h"
#include "core/mesh/crease_edges.h"
#include "core/mesh/facet_graph.h"
#include "core/mesh/triangle_bvh.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// A region is flat if its points are at most that far from a plane, relative to the diameter (0.15 px at 300 px), and
// its facets are inclined to it by at most 2 degrees.
constexpr double kFlatTolerance = 5e-4;
constexpr double kFlatAngle = 2.0 * kRadiansPerDegree;

// The number (FacetGraph) of the side of a triangle that is an edge of the mesh.
uint32_t SideAt(const RawMesh& mesh, uint32_t triangle, const std::array<uint32_t, 2>& ends) {
  const std::array<uint32_t, 3>& corners = mesh.triangles[triangle];
  uint32_t s = 0;
  while (corners[(s + 2) % 3] == ends[0] || corners[(s + 2) % 3] == ends[1]) ++s;  // the third corner is opposite
  return 3 * triangle + s;
}

// For each side of the triangles, whether the surface continues smoothly to the opposite one.
std::vector<bool> SmoothSides(const FacetGraph& graph, absl::Span<const MeshEdge> edges) {
  std::vector<bool> is_smooth(3 * graph.mesh().triangles.size());
  for (uint32_t side = 0; side < is_smooth.size(); ++side) is_smooth[side] = graph.opposite(side) != FacetGraph::kNone;
  for (const MeshEdge& edge : edges) {
    for (const uint32_t triangle : edge.triangles) is_smooth[SideAt(graph.mesh(), triangle, edge.ends)] = false;
  }
  return is_smooth;
}

// The edges at which two facets meet and the surface turns outward, as pairs of sides.
std::vector<std::array<uint32_t, 2>> ConvexFacetEdges(const FacetGraph& graph, const std::vector<bool>& is_smooth) {
  // Rounding to single precision turns the parts of a polygon against each other by 1e-4 where edges have a thousandth
  // of the model's size. A sphere of a million triangles turns by 3e-3 at an edge.
  constexpr double kLeastFacetTurn = 2e-4;
  std::vector<std::array<uint32_t, 2>> edges;
  for (uint32_t side = 0; side < is_smooth.size(); ++side) {
    if (!is_smooth[side] || side > graph.opposite(side)) continue;
    if (graph.turn_rad(side) > kLeastFacetTurn) edges.push_back({side, graph.opposite(side)});
  }
  return edges;
}

// Numbers the connected parts of the surface in the order of their first triangles. Returns their number.
uint32_t FloodRegions(const FacetGraph& graph, const std::vector<bool>& is_smooth, std::vector<uint32_t>& region_of) {
  region_of.assign(is_smooth.size() / 3, FacetGraph::kNone);
  uint32_t num_regions = 0;
  std::vector<uint32_t> open;
  for (uint32_t seed = 0; seed < region_of.size(); ++seed) {
    if (region_of[seed] != FacetGraph::kNone) continue;
    region_of[seed] = num_regions;
    open.assign(1, seed);
    while (!open.empty()) {
      const uint32_t triangle = open.back();
      open.pop_back();
      for (uint32_t side = 3 * triangle; side < 3 * triangle + 3; ++side) {
        if (!is_smooth[side]) continue;
        const uint32_t neighbour = graph.opposite(side) / 3;
        if (region_of[neighbour] != FacetGraph::kNone) continue;
        region_of[neighbour] = num_regions;
        open.push_back(neighbour);
      }
    }
    ++num_regions;
  }
  return num_regions;
}

// Marks the flat regions as planes and gives their corners the normal of the plane.
void FindPlanes(const FacetGraph& graph, double diameter_m, SmoothSurface& surface) {
  const RawMesh& mesh = graph.mesh();
  std::vector<double> area(surface.regions.size(), 0.0);
  std::vector<bool> is_flat(surface.regions.size(), true);
  const auto triangle_area = [&](const std::array<uint32_t, 3>& t) {
    return 0.5 * (mesh.points[t[1]] - mesh.points[t[0]]).cross(mesh.points[t[2]] - mesh.points[t[0]]).norm();
  };
  for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto& [i, j, k] = mesh.triangles[t];
    const double weight = triangle_area(mesh.triangles[t]);
    SurfaceRegion& region = surface.regions[surface.region_of[t]];
    region.point += weight / 3.0 * (mesh.points[i] + mesh.points[j] + mesh.points[k]);
    region.axis += weight * graph.normal(t);
    area[surface.region_of[t]] += weight;
  }
  for (size_t r = 0; r < surface.regions.size(); ++r) {
    surface.regions[r].point /= area[r];
    surface.regions[r].axis.normalize();
  }
  const double min_cosine = DeterministicSinCos(kFlatAngle).cos;
  for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    const uint32_t r = surface.region_of[t];
    const SurfaceRegion& region = surface.regions[r];
    is_flat[r] = is_flat[r] && graph.normal(t).dot(region.axis) >= min_cosine;
    for (const uint32_t vertex : mesh.triangles[t]) {
      const double distance_m = std::abs((mesh.points[vertex] - region.point).dot(region.axis));
      is_flat[r] = is_flat[r] && distance_m <= kFlatTolerance * diameter_m;
    }
  }
  for (size_t r = 0; r < surface.regions.size(); ++r) {
    if (is_flat[r]) {
      surface.regions[r].shape = RegionShape::kPlane;
    } else {
      surface.regions[r] = SurfaceRegion();
    }
  }
  for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    const SurfaceRegion& region = surface.regions[surface.region_of[t]];
    if (region.is_flat()) surface.normals[t].fill(region.axis.cast<float>());
  }
}

// The largest step across the gap between flush parts, relative to the diameter: 0.15 px of an object of 300 px.
constexpr double kJointStep = 5e-4;
constexpr double kJointTurn = 5.0 * kRadiansPerDegree;
// Least angle by which the surface turns from a face into the gap. At an edge with a smaller turn, the adjacent face
// could be taken for the face on the other side of a gap.
constexpr double kLeastFall = 30.0 * kRadiansPerDegree;
// Largest distance along an edge between the points that are tested, relative to the diameter: 6 px of an object of 300
// px; and the largest number of points of an edge.
constexpr double kJointStride = 0.02;
constexpr int kMaxJointPoints = 64;
constexpr double kEndInset = 0.05;  // of the length: beside the ends are the gaps of other edges
// Bounds time and memory. A surface with more edges is usually a scan, which has no joints.
constexpr size_t kMaxJointEdges = 100'000;

// The triangles at the vertices of edges.
TriangleBvh TrianglesBeside(const RawMesh& mesh, absl::Span<const MeshEdge> edges) {
  std::vector<bool> is_beside(mesh.points.size(), false);
  for (const MeshEdge& edge : edges) {
    for (const uint32_t vertex : edge.ends) is_beside[vertex] = true;
  }
  std::vector<std::array<uint32_t, 3>> triangles;
  for (const std::array<uint32_t, 3>& triangle : mesh.triangles) {
    if (std::any_of(triangle.begin(), triangle.end(), [&](uint32_t vertex) { return is_beside[vertex]; })) {
      triangles.push_back(triangle);
    }
  }
  return TriangleBvh(mesh.points, triangles);
}

// Finds edges at narrow gaps between flush parts (core/mesh/README.md, section 9).
class JointFinder {
 public:
  JointFinder(const FacetGraph& graph, double diameter_m, absl::Span<const MeshEdge> edges)
      : graph_(graph),
        diameter_m_(diameter_m),
        min_cosine_(DeterministicSinCos(kJointTurn).cos),
        faces_(TrianglesBeside(graph.mesh(), edges)) {}

  bool IsJoint(const MeshEdge& edge) {
    if (edge.kind == EdgeKind::kCrease && edge.turn_rad < kLeastFall) return false;
    return std::any_of(edge.triangles.begin(), edge.triangles.end(),
                       [&](uint32_t face) { return NothingRisesAbove(face, edge) && IsContinued(face, edge); });
  }

 private:
  const Eigen::Vector3d& Point(uint32_t vertex) const { return graph_.mesh().points[vertex]; }

  // Whether the other faces at the edge are below the plane of this one, or within the height of a step.
  bool NothingRisesAbove(uint32_t face, const MeshEdge& edge) const {
    const Eigen::Vector3d& normal = graph_.normal(face);
    return std::none_of(edge.triangles.begin(), edge.triangles.end(), [&](uint32_t other) {
      const uint32_t opposite = graph_.mesh().triangles[other][(SideAt(graph_.mesh(), other, edge.ends) + 2) % 3];
      return other != face && normal.dot(Point(opposite) - Point(edge.ends[0])) > kJointStep * diameter_m_;
    });
  }

  // Whether other faces continue this one beyond a gap, along the whole edge.
  bool IsContinued(uint32_t face, const MeshEdge& edge) {
    const Eigen::Vector3d& normal = graph_.normal(face);
    const Eigen::Vector3d& begin = Point(edge.ends[0]);
    const Eigen::Vector3d along = Point(edge.ends[1]) - begin;
    const Eigen::Vector3d beyond = -graph_.Into(SideAt(graph_.mesh(), face, edge.ends));
    const double strides = along.norm() / (kJointStride * diameter_m_);
    const int num_points = std::clamp(static_cast<int>(std::min(strides, 1e3)) + 2, 3, kMaxJointPoints);
    for (int i = 0; i < num_points; ++i) {
      const double position = kEndInset + (1.0 - 2.0 * kEndInset) * i / (num_points - 1);
      const Eigen::Vector3d point = begin + position * along + (kJointGap - kJointStep) * diameter_m_ * beyond;
      if (!faces_.HasNear(point, kJointStep * diameter_m_, normal, min_cosine_, hint_)) return false;
    }
    return true;
  }

  const FacetGraph& graph_;
  const double diameter_m_;
  const double min_cosine_;
  const TriangleBvh faces_;
  uint32_t hint_ = 0;
};

void RemoveJoints(const FacetGraph& graph, double diameter_m, SurfaceEdges& result) {
  result.are_joints_searched = result.edges.size() <= kMaxJointEdges;
  if (!result.are_joints_searched) return;
  JointFinder finder(graph, diameter_m, result.edges);
  result.num_joint_edges = std::erase_if(result.edges, [&](const MeshEdge& edge) { return finder.IsJoint(edge); });
}

}  // namespace

SurfaceEdges FindSurface(const RawMesh& mesh, const CreaseOptions& options, double diameter_m) {
  const FacetGraph graph(mesh);
  SurfaceEdges result;
  result.edges = FindCreases(graph, options, diameter_m);
  const std::vector<bool> is_smooth = SmoothSides(graph, result.edges);
  // Covered edges separate regions, but nothing is seen of them.
  std::erase_if(result.edges, [&mesh](const MeshEdge& edge) {
    return std::binary_search(mesh.covered_edges.begin(), mesh.covered_edges.end(), edge.ends);
  });
  if (!options.is_smooth) {
    result.facet_edges = ConvexFacetEdges(graph, is_smooth);
    return result;
  }
  RemoveJoints(graph, diameter_m, result);
  if (!mesh.exact_surface.empty()) {
    result.surface = mesh.exact_surface;
    return result;
  }
  result.surface.regions.resize(FloodRegions(graph, is_smooth, result.surface.region_of));
  result.surface.normals = CornerNormals(graph, is_smooth);
  FindPlanes(graph, diameter_m, result.surface);
  return result;
}

}  // namespace evpose
