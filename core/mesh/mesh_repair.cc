// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_repair.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <iterator>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/counted.h"
#include "core/mesh/inner_shells.h"
#include "core/mesh/mesh_junctions.h"
#include "core/mesh/mesh_overlaps.h"
#include "core/mesh/mesh_topology.h"

namespace evpose {
namespace {

// Tolerance as a share of the diagonal: 0.003 px at an object size of 300 px, and ten times the differences between
// programs that write the same corner twice.
constexpr double kRelativeTolerance = 1e-5;
// Roundings to single precision of the largest coordinate: files far from their origin lose digits.
constexpr double kRoundings = 4.0;
// Diagonals, in metres, of objects that an event camera sees as a whole at usual distances.
constexpr double kMinUsualSizeM = 0.005;
constexpr double kMaxUsualSizeM = 5.0;

double RepairTolerance(const RawMesh& mesh) {
  double largest_m = 0.0;
  for (const Eigen::Vector3d& point : mesh.points) largest_m = std::max(largest_m, point.cwiseAbs().maxCoeff());
  return std::max(kRelativeTolerance * BoundingBoxDiagonal(mesh),
                  kRoundings * std::numeric_limits<float>::epsilon() * largest_m);
}

void AddJunctions(const JunctionReport& junctions, RepairReport& report) {
  report.split_edges += junctions.split_edges;
  report.degenerate_triangles += junctions.degenerate_triangles;
  report.duplicate_triangles += junctions.duplicate_triangles;
  report.is_complete &= junctions.is_complete;
  report.is_searched &= junctions.is_searched;
}

void AddOrientation(const Orientation& orientation, RepairReport& report) {
  report.turned_triangles += orientation.turned;
  report.shells = orientation.shells;
  report.is_closed = orientation.is_closed;
  report.is_oriented = orientation.is_oriented;
}

// Turns stated normals to the outer side of their triangles. Those far from the triangle's normal are removed: they are
// means over creases, because the file has one normal for each vertex, and say nothing about the surface.
void AlignCornerNormals(RawMesh& mesh) {
  constexpr float kMinCosine = 0.7071f;  // 45 degrees, half the turn of a crease between perpendicular faces
  for (size_t t = 0; t < mesh.corner_normals.size(); ++t) {
    const auto& [i, j, k] = mesh.triangles[t];
    const Eigen::Vector3f normal =
        (mesh.points[j] - mesh.points[i]).cross(mesh.points[k] - mesh.points[i]).normalized().cast<float>();
    for (Eigen::Vector3f& stated : mesh.corner_normals[t]) {
      if (stated.dot(normal) < 0.0f) stated = -stated;
      if (stated.dot(normal) < kMinCosine) stated.setZero();
    }
  }
}

// Turns exact normals to the outer side of their triangles, with what a file derives from them: the axis of a plane,
// and whether a shape is convex. The normals of a face may be turned as a whole, because programs derive them and the
// winding from the same side.
void AlignExactSurface(RawMesh& mesh) {
  SmoothSurface& exact = mesh.exact_surface;
  std::vector<double> outward_m2(exact.regions.size());  // area, weighted with the cosine of normal and triangle
  for (size_t t = 0; t < exact.region_of.size(); ++t) {
    const auto& [i, j, k] = mesh.triangles[t];
    const Eigen::Vector3d area_m2 = (mesh.points[j] - mesh.points[i]).cross(mesh.points[k] - mesh.points[i]);
    for (const Eigen::Vector3f& normal : exact.normals[t]) {
      outward_m2[exact.region_of[t]] += area_m2.dot(normal.cast<double>());
    }
  }
  for (size_t t = 0; t < exact.region_of.size(); ++t) {
    if (outward_m2[exact.region_of[t]] >= 0.0) continue;
    for (Eigen::Vector3f& normal : exact.normals[t]) normal = -normal;
  }
  for (size_t r = 0; r < exact.regions.size(); ++r) {
    SurfaceRegion& region = exact.regions[r];
    if (outward_m2[r] >= 0.0 || region.shape == RegionShape::kFree) continue;
    if (region.is_flat()) {
      region.axis = -region.axis;
    } else {
      region.is_convex = !region.is_convex;
    }
  }
}

// `thing` in the singular, `what` happened to it.
void AddNoticeOf(size_t count, absl::string_view thing, absl::string_view what, std::vector<std::string>& notices) {
  if (count > 0) notices.push_back(absl::StrCat(Counted(count, thing), " ", what));
}

}  // namespace

size_t DropUnusedPoints(RawMesh& mesh) {
  constexpr uint32_t kUnused = ~0u;
  std::vector<uint32_t> index(mesh.points.size(), kUnused);
  const auto for_each_index = [&mesh](const auto& visit) {
    for (auto& triangle : mesh.triangles) std::for_each(triangle.begin(), triangle.end(), visit);
    for (auto& line : mesh.lines) std::for_each(line.begin(), line.end(), visit);
    for (ExactEdge& edge : mesh.exact_edges) std::for_each(edge.points.begin(), edge.points.end(), visit);
  };
  for_each_index([&index](uint32_t point) { index[point] = 0; });
  uint32_t num_used = 0;
  for (size_t i = 0; i < mesh.points.size(); ++i) {
    if (index[i] == kUnused) continue;
    index[i] = num_used;
    mesh.points[num_used++] = mesh.points[i];
  }
  const size_t num_unused = mesh.points.size() - num_used;
  if (num_unused == 0) return 0;
  mesh.points.resize(num_used);
  for_each_index([&index](uint32_t& point) { point = index[point]; });
  return num_unused;
}

RepairReport RepairMesh(RawMesh& mesh) {
  RepairReport report;
  const double tolerance_m = RepairTolerance(mesh);
  if (!(tolerance_m > 0.0)) return report;
  report.merged_points = MergePoints(tolerance_m, mesh);
  report.degenerate_triangles = RemoveCollapsedTriangles(mesh);
  report.duplicate_triangles = RemoveDuplicateTriangles(mesh);
  // Second sides are removed before the two sides differ, because junctions are closed for each surface.
  report.duplicate_triangles += RemoveSecondSides(mesh);
  report.empty_lines = RemoveEmptyLines(mesh);
  report.duplicate_lines = RemoveDuplicateLines(mesh);
  JunctionReport junctions = CloseJunctions(tolerance_m, mesh);
  AddJunctions(junctions, report);
  Orientation orientation = OrientTriangles(mesh);
  AddOrientation(orientation, report);
  // The first pass removes what is to be removed; the surface around it may then have junctions.
  constexpr int kMaxPasses = 3;
  // A mesh that has reached the limits on the work once would do so in each pass.
  for (int pass = 0; pass < kMaxPasses && orientation.shells > 1 && junctions.is_within_limits; ++pass) {
    OverlapReport overlaps = RemoveOverlaps(tolerance_m, orientation.shell_of, mesh);
    report.overlapping_triangles += overlaps.removed_triangles;
    report.is_complete &= overlaps.is_complete;
    mesh.covered_edges = std::move(overlaps.covered_edges);
    if (overlaps.removed_triangles == 0) break;
    junctions = CloseJunctions(tolerance_m, mesh);
    AddJunctions(junctions, report);
    orientation = OrientTriangles(mesh);
    AddOrientation(orientation, report);
    if (!overlaps.is_complete) break;
  }
  const InnerShells inner = RemoveInnerShells(tolerance_m, orientation.shell_of, orientation.shells, mesh);
  report.inner_shells = inner.shells;
  report.inner_triangles = inner.triangles;
  report.shells -= inner.shells;
  AlignCornerNormals(mesh);
  AlignExactSurface(mesh);
  return report;
}

void DescribeRepair(const RepairReport& report, std::vector<std::string>& notices) {
  AddNoticeOf(report.merged_points, "point", "merged with others within the tolerance", notices);
  AddNoticeOf(report.degenerate_triangles, "triangle", "without area dropped", notices);
  AddNoticeOf(report.duplicate_triangles, "duplicate triangle", "dropped", notices);
  AddNoticeOf(report.empty_lines, "line", "of length zero dropped", notices);
  AddNoticeOf(report.duplicate_lines, "duplicate line", "dropped", notices);
  AddNoticeOf(report.split_edges, "edge", "split at vertices of other triangles", notices);
  AddNoticeOf(report.overlapping_triangles, "overlapping triangle",
              "dropped: covered by others in the same plane, or between two bodies", notices);
  if (report.inner_shells > 0) {
    notices.push_back(absl::StrCat(Counted(report.inner_shells, "surface"), " with ",
                                   Counted(report.inner_triangles, "triangle"),
                                   " dropped: inside a closed surface, where no camera sees them"));
  }
  AddNoticeOf(report.turned_triangles, "triangle",
              "turned: the winding differed from that of the neighbours or was inward", notices);
  if (!report.is_oriented) {
    notices.push_back("a surface with one side, such as a Moebius strip: its winding stays as it is");
  }
  if (!report.is_complete) {
    notices.push_back("the mesh has more faults than are repaired; check it, and export it again");
  }
}

void NoteImplausibleSize(const RawMesh& in_metres, double metres_per_unit, std::vector<std::string>& notices) {
  const auto is_usual = [](double size_m) { return size_m >= kMinUsualSizeM && size_m <= kMaxUsualSizeM; };
  const double diagonal_m = BoundingBoxDiagonal(in_metres);
  if (!(diagonal_m > 0.0) || is_usual(diagonal_m)) return;
  struct Unit {
    const char* name;
    double metres;
  };
  constexpr Unit kUnits[] = {// the more frequent ones first
                             {"millimetres", 0.001},
                             {"metres", 1.0},
                             {"inches", 0.0254},
                             {"centimetres", 0.01},
                             {"micrometres", 1e-6}};
  const auto taken_as = std::find_if(std::begin(kUnits), std::end(kUnits),
                                     [&](const Unit& unit) { return unit.metres == metres_per_unit; });
  const auto probable = std::find_if(std::begin(kUnits), std::end(kUnits), [&](const Unit& unit) {
    return is_usual(diagonal_m / metres_per_unit * unit.metres);
  });
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : in_metres.points) box.extend(point);
  std::string notice = absl::StrFormat("largest side %.5g units: taken as ", box.sizes().maxCoeff() / metres_per_unit);
  if (taken_as != std::end(kUnits)) {
    absl::StrAppend(&notice, taken_as->name);
  } else {
    absl::StrAppendFormat(&notice, "%.5g m", box.sizes().maxCoeff());
  }
  if (probable != std::end(kUnits)) {
    absl::StrAppendFormat(&notice, "; if these are %s pass --scale %g", probable->name, probable->metres);
  } else {
    absl::StrAppend(&notice, diagonal_m > kMaxUsualSizeM ? ", which is unusually large" : ", which is unusually small",
                    "; check the unit of the file, and pass its metres as --scale");
  }
  notices.push_back(std::move(notice));
}

}  // namespace evpose
