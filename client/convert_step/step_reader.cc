// SPDX-License-Identifier: Apache-2.0
#include "client/convert_step/step_reader.h"

#include <BRepBndLib.hxx>
#include <BRepGProp.hxx>
#include <BRepMesh_IncrementalMesh.hxx>
#include <BRep_Tool.hxx>
#include <Bnd_Box.hxx>
#include <Eigen/Geometry>
#include <GProp_GProps.hxx>
#include <IMeshData_Status.hxx>
#include <Poly_Triangulation.hxx>
#include <Standard_Failure.hxx>
#include <TopExp_Explorer.hxx>
#include <TopLoc_Location.hxx>
#include <TopTools_DataMapOfShapeInteger.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Shape.hxx>
#include <array>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/convert_step/face_surface.h"
#include "client/convert_step/step_edges.h"
#include "client/convert_step/step_shape.h"
#include "core/base/check_range.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// OpenCASCADE converts the unit of every file to millimetres, for which its tolerances are made.
constexpr double kMetresPerUnit = 1e-3;
// Where a surface has no normal, that of a point this share of the way to the opposite side is taken.
constexpr double kTowardsOpposite = 0.01;
// Largest distance between edges that are joined, relative to the diagonal: 0.03 px at a size of 300 px, and 0.01 mm in
// a part of 100 mm, which is the precision of many IGES files.
constexpr double kJoinTolerance = 1e-4;
// States of the triangulation after which a face may lack parts.
constexpr int kFailures = IMeshData_OpenWire | IMeshData_SelfIntersectingWire | IMeshData_Failure |
                          IMeshData_UnorientedWire | IMeshData_TooFewPoints;

// `notices` may have the cause.
absl::Status NoFaceError(const std::vector<std::string>& notices) {
  std::string error = "has no face: export the object as solids or surfaces; curves alone are not enough";
  if (!notices.empty()) absl::StrAppend(&error, " (", notices.front(), ")");
  return absl::InvalidArgumentError(error);
}

Eigen::Vector3d PointOf(const Poly_Triangulation& mesh, const TopLoc_Location& location, int node) {
  const gp_Pnt point = mesh.Node(node).Transformed(location.Transformation());
  return {point.X(), point.Y(), point.Z()};
}

Eigen::Vector2d ParametersOf(const Poly_Triangulation& mesh, int node) {
  return {mesh.UVNode(node).X(), mesh.UVNode(node).Y()};
}

// The nodes of a triangle, counter-clockwise seen from outside.
std::array<int, 3> NodesOf(const Poly_Triangulation& mesh, int triangle, bool is_reversed) {
  std::array<int, 3> nodes;
  mesh.Triangle(triangle).Get(nodes[0], nodes[1], nodes[2]);
  if (is_reversed) std::swap(nodes[1], nodes[2]);
  return nodes;
}

// Parameters near a pole, where one of the two parameters has no effect and the other is that of the pole. The first is
// that of the middle of the opposite side.
Eigen::Vector2d BesidePole(const FaceSurface& surface, const Eigen::Vector2d& pole, const Eigen::Vector2d& opposite) {
  const Eigen::Vector2d near_pole = pole + kTowardsOpposite * (opposite - pole);
  const Eigen::Vector2d u_is_free(opposite.x(), near_pole.y()), v_is_free(near_pole.x(), opposite.y());
  const Eigen::Vector3d point = surface.Point(pole);
  const double u_distance = (surface.Point(u_is_free) - point).norm();
  return u_distance <= (surface.Point(v_is_free) - point).norm() ? u_is_free : v_is_free;
}

// The normals of the surface at the corners of a triangle; that of the triangle where there is no other.
std::array<Eigen::Vector3d, 3> CornerNormals(const FaceSurface& surface, const Poly_Triangulation& mesh,
                                             const std::array<int, 3>& nodes,
                                             const std::array<Eigen::Vector3d, 3>& points) {
  const Eigen::Vector3d of_triangle = (points[1] - points[0]).cross(points[2] - points[0]).normalized();
  std::array<Eigen::Vector3d, 3> normals = {of_triangle, of_triangle, of_triangle};
  if (!mesh.HasUVNodes()) return normals;
  for (size_t i = 0; i < 3; ++i) {
    const Eigen::Vector2d parameters = ParametersOf(mesh, nodes[i]);
    Eigen::Vector3d normal = surface.Normal(parameters);
    if (normal.isZero(0.0)) {
      const Eigen::Vector2d opposite =
          (ParametersOf(mesh, nodes[(i + 1) % 3]) + ParametersOf(mesh, nodes[(i + 2) % 3])) / 2.0;
      normal = surface.Normal(BesidePole(surface, parameters, opposite));
    }
    if (!normal.isZero(0.0)) normals[i] = normal;
  }
  return normals;
}

// Appends the triangles of a face as one region.
void AppendFace(const TopoDS_Face& face, RawMesh& out) {
  TopLoc_Location location;
  const opencascade::handle<Poly_Triangulation> mesh = BRep_Tool::Triangulation(face, location);
  if (mesh.IsNull()) return;  // a face without area
  const FaceSurface surface(face);
  const auto first = static_cast<uint32_t>(out.points.size());
  for (int i = 1; i <= mesh->NbNodes(); ++i) out.points.push_back(kMetresPerUnit * PointOf(*mesh, location, i));
  SmoothSurface& exact = out.exact_surface;
  const auto region = static_cast<uint32_t>(exact.regions.size());
  for (int i = 1; i <= mesh->NbTriangles(); ++i) {
    const std::array<int, 3> nodes = NodesOf(*mesh, i, face.Orientation() == TopAbs_REVERSED);
    std::array<Eigen::Vector3d, 3> points;
    for (size_t k = 0; k < 3; ++k) points[k] = PointOf(*mesh, location, nodes[k]);
    const double area = (points[1] - points[0]).cross(points[2] - points[0]).norm();
    if (!(area > 0.0)) continue;
    const std::array<Eigen::Vector3d, 3> normals = CornerNormals(surface, *mesh, nodes, points);
    if (exact.regions.size() == region) exact.regions.push_back(surface.Region(points[0], normals[0], kMetresPerUnit));
    const auto index = [&](size_t k) { return first + static_cast<uint32_t>(nodes[k] - 1); };
    out.triangles.push_back({index(0), index(1), index(2)});
    exact.region_of.push_back(region);
    exact.normals.push_back({normals[0].cast<float>(), normals[1].cast<float>(), normals[2].cast<float>()});
  }
}

// Area of the triangles of a mesh from one on, in square metres.
double AreaFrom(size_t triangle, const RawMesh& mesh) {
  double area_m2 = 0.0;
  for (; triangle < mesh.triangles.size(); ++triangle) {
    const auto& [i, j, k] = mesh.triangles[triangle];
    area_m2 += 0.5 * (mesh.points[j] - mesh.points[i]).cross(mesh.points[k] - mesh.points[i]).norm();
  }
  return area_m2;
}

// The faces of which OpenCASCADE has made no triangles, or of which parts are missing.
class IncompleteFaces {
 public:
  // `min_width`: narrower faces have no area that is seen.
  explicit IncompleteFaces(double min_width) : min_width_(min_width) {}

  void Check(const TopoDS_Face& face, double area_of_triangles) {
    Bnd_Box box;
    BRepBndLib::Add(face, box);
    if (box.IsVoid()) return;
    GProp_GProps properties;
    BRepGProp::SurfaceProperties(face, properties);
    // The sign is that of the face's orientation.
    const double area = std::abs(properties.Mass());
    const bool is_narrow = area <= min_width_ * std::sqrt(box.SquareExtent());
    if (!HasOpenWire(face) && (is_narrow || area_of_triangles >= kLeastShare * area)) return;
    if (count_++ > 0) return;
    const gp_Pnt low = box.CornerMin(), high = box.CornerMax();
    place_ = absl::StrFormat("(%.4g, %.4g, %.4g) mm", (low.X() + high.X()) / 2.0, (low.Y() + high.Y()) / 2.0,
                             (low.Z() + high.Z()) / 2.0);
  }

  void Describe(std::vector<std::string>& notices) const {
    if (count_ == 0) return;
    notices.push_back(
        absl::StrCat(Counted(count_, "face"),
                     " cannot be triangulated as a whole: the object has a hole there, the borders of which "
                     "count as edges. The first one is near ",
                     place_, ": repair it in the CAD program, and export the object again"));
  }

 private:
  static bool HasOpenWire(const TopoDS_Face& face) {
    for (TopExp_Explorer wires(face, TopAbs_WIRE); wires.More(); wires.Next()) {
      if (!BRep_Tool::IsClosed(wires.Current())) return true;
    }
    return false;
  }

  static constexpr double kLeastShare = 0.9;  // facets of convex and concave faces lose and gain a few per cent at most
  const double min_width_;
  uint64_t count_ = 0;
  std::string place_;  // of the first face
};

absl::StatusOr<RawMesh> Triangulate(const TopoDS_Shape& shape, double diagonal, const StepOptions& options,
                                    std::vector<std::string>& notices) {
  const double deflection = options.deflection_ratio * diagonal;
  const BRepMesh_IncrementalMesh mesher(shape, deflection, /*isRelative=*/false, options.turn_rad);
  const bool has_failed = (mesher.GetStatusFlags() & kFailures) != 0;
  RawMesh mesh;
  IncompleteFaces incomplete(deflection);
  TopTools_DataMapOfShapeInteger first_points;  // index of the first point of each face
  for (TopExp_Explorer faces(shape, TopAbs_FACE); faces.More(); faces.Next()) {
    const size_t first_triangle = mesh.triangles.size();
    first_points.Bind(faces.Current(), static_cast<int>(mesh.points.size()));
    AppendFace(TopoDS::Face(faces.Current()), mesh);
    if (mesh.triangles.size() > options.max_triangles) {
      return absl::InvalidArgumentError(
          absl::StrCat("has more than ", options.max_triangles, " triangles; remove small parts"));
    }
    if (has_failed || mesh.triangles.size() == first_triangle) {
      incomplete.Check(TopoDS::Face(faces.Current()),
                       AreaFrom(first_triangle, mesh) / (kMetresPerUnit * kMetresPerUnit));
    }
  }
  incomplete.Describe(notices);
  if (mesh.triangles.empty()) return NoFaceError(notices);
  AppendEdges(shape, first_points, kMetresPerUnit, options.edge_deflection_ratio * diagonal, mesh);
  return mesh;
}

absl::StatusOr<StepModel> ReadAndTriangulate(const std::string& path, const StepOptions& options) {
  StepModel model;
  EVPOSE_ASSIGN_OR_RETURN(const TopoDS_Shape shape, ReadShape(path, model.notices));
  Bnd_Box box;
  BRepBndLib::Add(shape, box);
  if (box.IsVoid() || !TopExp_Explorer(shape, TopAbs_FACE).More()) return NoFaceError(model.notices);
  const double diagonal = std::sqrt(box.SquareExtent());
  const TopoDS_Shape joined = JoinFaces(shape, kJoinTolerance * diagonal, model.notices);
  EVPOSE_ASSIGN_OR_RETURN(model.mesh, Triangulate(joined, diagonal, options, model.notices));
  return model;
}

}  // namespace

absl::Status StepOptions::Validate() const {
  constexpr double kMaxTriangles = 1e8;  // indices have 32 bits
  EVPOSE_RETURN_IF_ERROR(CheckRange("StepOptions.deflection_ratio", deflection_ratio, 1e-7, 0.1));
  EVPOSE_RETURN_IF_ERROR(CheckRange("StepOptions.turn_rad", turn_rad, 1e-3, 1.5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("StepOptions.edge_deflection_ratio", edge_deflection_ratio, 1e-7, 0.1));
  return CheckRange("StepOptions.max_triangles", static_cast<double>(max_triangles), 1.0, kMaxTriangles);
}

absl::StatusOr<StepModel> ReadStep(const std::string& path, const StepOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  try {
    return ReadAndTriangulate(path, options);
  } catch (const Standard_Failure& failure) {
    return absl::InvalidArgumentError(absl::StrCat("OpenCASCADE cannot convert it: ", failure.GetMessageString()));
  }
}

}  // namespace evpose::client
