// SPDX-License-Identifier: Apache-2.0
#include "core/models/object_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/counted.h"
#include "core/base/length_text.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/geometry/spiral_direction.h"
#include "core/mesh/loading/model_readers.h"
#include "core/mesh/mesh_repair.h"
#include "core/mesh/mesh_topology.h"
#include "core/mesh/region_shapes.h"
#include "core/mesh/simplify.h"
#include "core/mesh/surface_regions.h"
#include "core/models/collinear_lines.h"
#include "core/models/continuous_symmetry.h"
#include "core/models/edge_curves.h"
#include "core/models/symmetry.h"

namespace evpose {
namespace {

// A mesh of more triangles is simplified: the time of a view grows with their number.
constexpr size_t kMaxKeptTriangles = 60'000;
// Largest error of that, relative to the diameter: 0.03 px at 300 px.
constexpr double kSimplifyTolerance = 1e-4;
// Diagonal of the bounding box: from a thousandth of a millimetre, below what a lens resolves, to 10 km, far beyond the
// objects whose edges an event camera sees. Squares of such sizes keep their precision; others are wrong units.
constexpr double kMinSizeM = 1e-6;
constexpr double kMaxSizeM = 1e4;
// Largest distance from the origin, relative to the model's size: beyond it, rounding to single precision moves points
// by more than 0.6 % of the size.
constexpr double kMaxRelativeOffset = 1e5;
// Relative to the diameter: 0.3 px at an object size of 300 px, below what distinguishes two orientations in an image,
// but above the rounding errors of drawings.
constexpr double kSymmetryTolerance = 1e-3;
// All pairs of more points would take longer than some milliseconds.
constexpr size_t kMaxExactDiameterPoints = 2048;

absl::Status CheckExtent(const RawMesh& raw) {
  const double diagonal_m = BoundingBoxDiagonal(raw);
  double offset_m = 0.0;
  for (const Eigen::Vector3d& point : raw.points) {
    if (!point.allFinite()) return absl::InvalidArgumentError("a coordinate is not finite");
    offset_m = std::max(offset_m, point.cwiseAbs().maxCoeff());
  }
  if (!(diagonal_m >= kMinSizeM && diagonal_m <= kMaxSizeM)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("the model's size is %s; models of %s to %s are accepted: check its unit (--scale)",
                        FormatLength(diagonal_m), FormatLength(kMinSizeM), FormatLength(kMaxSizeM)));
  }
  if (offset_m > kMaxRelativeOffset * diagonal_m) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "the model has a size of %g m, but lies %g m from its origin; move it there", diagonal_m, offset_m));
  }
  return absl::OkStatus();
}

double LargestDistance(absl::Span<const Eigen::Vector3d> points) {
  double largest2 = 0.0;
  for (size_t i = 0; i < points.size(); ++i) {
    for (size_t j = i + 1; j < points.size(); ++j) largest2 = std::max(largest2, (points[i] - points[j]).squaredNorm());
  }
  return std::sqrt(largest2);
}

// Exact for up to kMaxExactDiameterPoints points. For more, the largest distance between the outermost points along 256
// directions on a Fibonacci half sphere. Every direction is within 0.14 rad of one of them, and cos(0.14) > 0.99: the
// result is at most 1 % too small.
double Diameter(absl::Span<const Eigen::Vector3d> points) {
  if (points.size() <= kMaxExactDiameterPoints) return LargestDistance(points);
  constexpr int kDirections = 256;
  std::vector<Eigen::Vector3d> outermost;
  for (int i = 0; i < kDirections; ++i) {
    const Eigen::Vector3d direction = SpiralDirection(i, (i + 0.5) / kDirections);
    size_t low = 0, high = 0;
    double lowest = points[0].dot(direction), highest = lowest;
    for (size_t p = 1; p < points.size(); ++p) {
      const double height = points[p].dot(direction);
      if (height < lowest) {
        lowest = height;
        low = p;
      }
      if (height >= highest) {
        highest = height;
        high = p;
      }
    }
    outermost.push_back(points[low]);
    outermost.push_back(points[high]);
  }
  return LargestDistance(outermost);
}

// Moves the triangles and the points that they use, in their order, to the model.
void TakeTriangles(RawMesh raw, ObjectModel& model) {
  constexpr uint32_t kUnused = ~0u;
  std::vector<uint32_t> index(raw.points.size(), kUnused);
  for (const auto& triangle : raw.triangles) {
    for (const uint32_t vertex : triangle) index[vertex] = 0;
  }
  for (size_t i = 0; i < raw.points.size(); ++i) {
    if (index[i] == kUnused) continue;
    index[i] = static_cast<uint32_t>(model.vertices.size());
    model.vertices.push_back(raw.points[i]);
  }
  for (auto& triangle : raw.triangles) {
    for (uint32_t& vertex : triangle) vertex = index[vertex];
  }
  model.triangles = std::move(raw.triangles);
}

void ScaleMesh(double factor, RawMesh& mesh) {
  for (Eigen::Vector3d& point : mesh.points) point *= factor;
  for (SurfaceRegion& region : mesh.exact_surface.regions) {
    region.point *= factor;
    region.radius_m *= factor;
  }
  for (ExactEdge& edge : mesh.exact_edges) {
    edge.circle.centre *= factor;
    edge.circle.radius_m *= factor;
  }
}

void NoteJoints(const SurfaceEdges& surface, ObjectModel& model) {
  if (!surface.are_joints_searched) {
    model.notices.push_back("joints of flush parts not searched: too many edges");
  }
  const size_t num_edges = surface.num_joint_edges;
  if (num_edges == 0) return;
  model.notices.push_back(absl::StrFormat(
      "%s at gaps of less than %s between flush parts left out: such lines are too narrow to be seen",
      Counted(num_edges, "edge of the mesh", "edges of the mesh"), FormatLength(kJointGap * model.diameter_m)));
}

double TotalLength(const RawMesh& mesh, absl::Span<const std::array<uint32_t, 2>> lines) {
  double length_m = 0.0;
  for (const auto& [from, to] : lines) length_m += (mesh.points[to] - mesh.points[from]).norm();
  return length_m;
}

// Line elements replace the edges of the surface. A file whose line elements are much shorter than these edges may have
// them for another purpose. Printed patterns, whose lines leave out the border of the sheet, have two thirds of them.
void NoteReplacedEdges(const RawMesh& mesh, const SurfaceEdges& surface, std::vector<std::string>& notices) {
  std::vector<std::array<uint32_t, 2>> edges;
  for (const MeshEdge& edge : surface.edges) edges.push_back(edge.ends);
  constexpr double kMuchShorter = 0.5;
  const double lines_m = TotalLength(mesh, mesh.lines), edges_m = TotalLength(mesh, edges);
  if (lines_m >= kMuchShorter * edges_m) return;
  notices.push_back(absl::StrFormat(
      "the line elements (l) of the file, %s in all, are taken as all edges of the object: those of its faces, %s in "
      "all, are not used; remove the line elements if they are not the edges of the object",
      FormatLength(lines_m), FormatLength(edges_m)));
}

// Whether all points lie in one plane, which no solid object does.
bool IsSheet(const RawMesh& mesh, double diameter_m) {
  constexpr double kFlatness = 1e-4;  // relative to the diameter
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  for (const auto& [a, b, c] : mesh.triangles) {
    const Eigen::Vector3d cross = (mesh.points[b] - mesh.points[a]).cross(mesh.points[c] - mesh.points[a]);
    if (cross.squaredNorm() > normal.squaredNorm()) normal = cross;
  }
  normal.normalize();
  return std::all_of(mesh.points.begin(), mesh.points.end(), [&](const Eigen::Vector3d& point) {
    return std::abs(normal.dot(point - mesh.points[0])) <= kFlatness * diameter_m;
  });
}

// Missing faces are the most frequent cause of edges that the object does not have.
void NoteOpenSurface(const RawMesh& mesh, const SurfaceEdges& surface, ObjectModel& model) {
  const auto num_ends = std::count_if(surface.edges.begin(), surface.edges.end(),
                                      [](const MeshEdge& edge) { return edge.kind == EdgeKind::kBoundary; });
  if (num_ends == 0 || IsSheet(mesh, model.diameter_m)) return;
  model.notices.push_back(absl::StrFormat(
      "the surface is open: it ends at %s, which count as visible edges; if the object is solid, export it as a closed "
      "body",
      Counted(static_cast<uint64_t>(num_ends), "edge of the mesh", "edges of the mesh")));
}

// The edges of the model: the line elements, and those of the surface unless the line elements are all.
void FindEdges(const RawMesh& mesh, const SurfaceEdges& surface, const ModelOptions& options, ModelStepListener on_step,
               ObjectModel& model) {
  on_step("finding lines");
  if (!mesh.lines.empty()) AddPaintedEdges(mesh, options.is_smooth, model);
  if (mesh.lines.empty() || !mesh.lines_are_all) {
    NoteJoints(surface, model);
    NoteOpenSurface(mesh, surface, model);
    AddSurfaceEdges(mesh, surface, model);
  } else {
    NoteReplacedEdges(mesh, surface, model.notices);
  }
  on_step("joining lines");
  MergeOverlapping(kCollinearTolerance * BoundingBoxDiagonal(mesh), model.lines, model.notices);
}

bool IsFlat(const SmoothSurface& surface) {
  return std::all_of(surface.regions.begin(), surface.regions.end(),
                     [](const SurfaceRegion& region) { return region.is_flat(); });
}

// Leaves fewer triangles of a dense mesh, inside its regions, to hide edges and to have contours.
void Simplify(double diameter_m, RawMesh& mesh, SmoothSurface& surface, std::vector<std::string>& notices) {
  if (surface.empty() || mesh.triangles.size() <= kMaxKeptTriangles) return;
  const Simplification done = SimplifyMesh(kMaxKeptTriangles, kSimplifyTolerance * diameter_m, mesh, surface);
  if (done.triangles_after == done.triangles_before) return;
  notices.push_back(absl::StrFormat("the surface is simplified from %d to %d triangles, by at most %.2g m",
                                    done.triangles_before, done.triangles_after, done.error_m));
}

// Each triangle without neighbours is three edges of the object. A million of them is no object that can be tracked,
// and the steps after the repair would need more memory than a server allows.
absl::Status CheckIsSurface(const RepairReport& repair, size_t num_triangles) {
  if (repair.is_searched || 2 * repair.shells <= num_triangles) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat(
      "repairing the mesh: its %d triangles are %d separate surfaces, too many to search for corners that lie on edges "
      "of others; export the object as a surface of connected triangles",
      num_triangles, repair.shells));
}

absl::Status CheckHasElements(const RawMesh& mesh) {
  if (!mesh.triangles.empty() || !mesh.lines.empty()) return absl::OkStatus();
  if (mesh.points.empty()) {
    return absl::InvalidArgumentError(
        "the model file has no line and no face: export the faces of the object, or check that the file is complete");
  }
  std::string error = absl::StrCat("the model file has ", Counted(mesh.points.size(), "point"),
                                   ", but no line and no face: a cloud of points has no surface; export the faces of "
                                   "the object, or compute a mesh from the points");
  // They name elements that are not read.
  for (const std::string& notice : mesh.notices) absl::StrAppend(&error, " (", notice, ")");
  return absl::InvalidArgumentError(error);
}

// Builds the model of a mesh in metres. `unit_is_stated`: the unit is known, whatever the size.
absl::StatusOr<ObjectModel> BuildFromMetres(RawMesh mesh, const ModelOptions& options, ModelStepListener on_step,
                                            bool unit_is_stated) {
  EVPOSE_RETURN_IF_ERROR(CheckHasElements(mesh));
  ObjectModel model;
  TakeNotices(mesh, model.notices);
  if (const size_t unused = DropUnusedPoints(mesh); unused > 0) {
    model.notices.push_back(absl::StrCat(Counted(unused, "point"), " that no face or line uses dropped"));
  }
  if (!unit_is_stated) NoteImplausibleSize(mesh, options.metres_per_unit, model.notices);
  EVPOSE_RETURN_IF_ERROR(CheckExtent(mesh));
  const bool has_line_elements = !mesh.lines.empty();
  on_step("repairing the mesh");
  const RepairReport repair = RepairMesh(mesh);
  EVPOSE_RETURN_IF_ERROR(CheckIsSurface(repair, mesh.triangles.size()));
  DescribeRepair(repair, model.notices);
  on_step("measuring the diameter");
  model.diameter_m = Diameter(mesh.points);
  on_step("finding creases");
  SurfaceEdges surface = FindSurface(mesh, {options.crease_angle_deg, options.is_smooth}, model.diameter_m);
  on_step("fitting shapes");
  if (!surface.surface.empty()) FitShapes(mesh, model.diameter_m, surface.surface);
  FindEdges(mesh, surface, options, on_step, model);
  if (mesh.triangles.empty()) {
    model.notices.push_back("the model has no faces: edges that the object hides are expected to be visible");
  }
  const bool is_flat = IsFlat(surface.surface);
  model.facet_edges = std::move(surface.facet_edges);
  if (model.lines.empty() && model.curves.empty() && is_flat && model.facet_edges.empty()) {
    return absl::InvalidArgumentError(
        has_line_elements
            ? "has no line: all its line elements (l) have length zero"
            : absl::StrFormat(
                  "has no line and no curved surface: apart from gaps between flush parts, no edge turns by "
                  "more than %g degrees and none is a boundary; lower the crease angle, or draw the "
                  "visible lines as OBJ line elements (l)",
                  options.crease_angle_deg));
  }
  on_step("simplifying the mesh");
  Simplify(model.diameter_m, mesh, surface.surface, model.notices);
  if (!is_flat) model.surface = std::move(surface.surface);
  TakeTriangles(std::move(mesh), model);
  on_step("finding symmetries");
  model.continuous_symmetry = FindContinuousSymmetry(model, &model.notices);
  if (!model.continuous_symmetry.has_value()) {
    model.symmetries = FindSymmetries(model, kSymmetryTolerance, &model.notices);
  }
  return model;
}

}  // namespace

absl::StatusOr<ObjectModel> BuildObjectModel(RawMesh mesh, const ModelOptions& options, ModelStepListener on_step) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  ScaleMesh(options.metres_per_unit, mesh);
  return BuildFromMetres(std::move(mesh), options, on_step, true);
}

absl::Status ModelOptions::Validate() const {
  // Indices have 32 bits, and a triangle may have three points of its own.
  constexpr double kMaxCount = 1e8;
  EVPOSE_RETURN_IF_ERROR(CheckPositive("metres_per_unit", metres_per_unit));
  EVPOSE_RETURN_IF_ERROR(CheckRange("crease_angle_deg", crease_angle_deg, 0.0, 180.0, OpenEnds::kBoth));
  return CheckRange("max_triangles", static_cast<double>(max_triangles), 0.0, kMaxCount);
}

absl::Status ModelOptions::CheckSize(size_t file_bytes) const {
  if (file_bytes == 0) return absl::InvalidArgumentError("the model file is empty");
  if (file_bytes <= max_bytes) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("the model has %d bytes, more than the limit of %d", file_bytes, max_bytes));
}

absl::StatusOr<RawMesh> ReadMesh(absl::Span<const uint8_t> bytes, ModelFormat format, const ModelOptions& options) {
  switch (format) {
    case ModelFormat::kObj:
      return ReadObj(bytes, {options.max_triangles});
    case ModelFormat::kPly:
      return ReadPly(bytes, {options.max_triangles});
    case ModelFormat::kStl:
      return ReadStl(bytes, {options.max_triangles});
    case ModelFormat::kMesh:
      break;
  }
  return absl::InvalidArgumentError("the format is none of OBJ, PLY and STL");
}

absl::StatusOr<ObjectModel> ParseObjectModel(absl::Span<const uint8_t> bytes, ModelFormat format,
                                             const ModelOptions& options, ModelStepListener on_step) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(options.CheckSize(bytes.size()));
  on_step("reading the file");
  EVPOSE_ASSIGN_OR_RETURN(RawMesh mesh, ReadMesh(bytes, format, options));
  ScaleMesh(options.metres_per_unit, mesh);
  return BuildFromMetres(std::move(mesh), options, on_step, false);
}

absl::StatusOr<ModelFormat> ModelFormatFromPath(const std::string& path) {
  const std::string ending = absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  if (ending == ".obj") return ModelFormat::kObj;
  if (ending == ".ply") return ModelFormat::kPly;
  if (ending == ".stl") return ModelFormat::kStl;
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": unknown model format; the name must end in .obj, .ply or .stl"));
}

absl::StatusOr<ObjectModel> LoadObjectModel(const std::string& path, const ModelOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const ModelFormat format, ModelFormatFromPath(path));
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path, options.max_bytes));
  absl::StatusOr<ObjectModel> model =
      ParseObjectModel({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}, format, options);
  if (!model.ok()) return absl::Status(model.status().code(), absl::StrCat(path, ": ", model.status().message()));
  return model;
}

std::string ObjectModelToObj(const ObjectModel& model) {
  std::string obj;
  // 17 significant digits determine a double; the reader then rounds to single precision.
  const auto add_vertex = [&obj](const Eigen::Vector3d& v) {
    absl::StrAppendFormat(&obj, "v %.17g %.17g %.17g\n", v.x(), v.y(), v.z());
  };
  for (const Eigen::Vector3d& vertex : model.vertices) add_vertex(vertex);
  for (const ModelLine& line : model.lines) {
    add_vertex(line.p1);
    add_vertex(line.p2);
  }
  for (const EdgeCurve& curve : model.curves) {
    for (const Eigen::Vector3d& point : curve.points) add_vertex(point);
  }
  for (const auto& [i, j, k] : model.triangles) absl::StrAppendFormat(&obj, "f %d %d %d\n", i + 1, j + 1, k + 1);
  size_t next = model.vertices.size() + 1;
  for (size_t i = 0; i < model.lines.size(); ++i, next += 2) absl::StrAppendFormat(&obj, "l %d %d\n", next, next + 1);
  for (const EdgeCurve& curve : model.curves) {
    obj += 'l';
    for (size_t i = 0; i < curve.points.size(); ++i) absl::StrAppendFormat(&obj, " %d", next++);
    obj += '\n';
  }
  return obj;
}

}  // namespace evpose
