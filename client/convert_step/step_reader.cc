// SPDX-License-Identifier: Apache-2.0
#include "client/convert_step/step_reader.h"

#include <BRepBndLib.hxx>
#include <BRepMesh_IncrementalMesh.hxx>
#include <BRep_Tool.hxx>
#include <Bnd_Box.hxx>
#include <Eigen/Geometry>
#include <IGESControl_Reader.hxx>
#include <Poly_Triangulation.hxx>
#include <STEPControl_Reader.hxx>
#include <Standard_Failure.hxx>
#include <TopExp_Explorer.hxx>
#include <TopLoc_Location.hxx>
#include <TopTools_DataMapOfShapeInteger.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Shape.hxx>
#include <array>
#include <cmath>
#include <filesystem>
#include <memory>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "client/convert_step/face_surface.h"
#include "client/convert_step/step_edges.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// OpenCASCADE converts the unit of every file to millimetres, for which its tolerances are made.
constexpr double kMetresPerUnit = 1e-3;
// Where a surface has no normal, that of a point this share of the way to the opposite side is taken.
constexpr double kTowardsOpposite = 0.01;

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

absl::StatusOr<TopoDS_Shape> ReadShape(const std::string& path) {
  const std::string extension = absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  std::unique_ptr<XSControl_Reader> reader;
  if (extension == ".igs" || extension == ".iges") {
    reader = std::make_unique<IGESControl_Reader>();
  } else {
    reader = std::make_unique<STEPControl_Reader>();
  }
  if (reader->ReadFile(path.c_str()) != IFSelect_RetDone) {
    return absl::InvalidArgumentError("cannot be read: it is no STEP or IGES file, or it is damaged");
  }
  reader->TransferRoots();
  TopoDS_Shape shape = reader->OneShape();
  if (shape.IsNull()) return absl::InvalidArgumentError("has no shape");
  return shape;
}

absl::StatusOr<RawMesh> Triangulate(const TopoDS_Shape& shape, const StepOptions& options) {
  Bnd_Box box;
  BRepBndLib::Add(shape, box);
  if (box.IsVoid()) return absl::InvalidArgumentError("has no face");
  const double deflection = options.deflection_ratio * std::sqrt(box.SquareExtent());
  const BRepMesh_IncrementalMesh mesher(shape, deflection, /*isRelative=*/false, options.turn_rad);
  RawMesh mesh;
  TopTools_DataMapOfShapeInteger first_points;  // index of the first point of each face
  for (TopExp_Explorer faces(shape, TopAbs_FACE); faces.More(); faces.Next()) {
    first_points.Bind(faces.Current(), static_cast<int>(mesh.points.size()));
    AppendFace(TopoDS::Face(faces.Current()), mesh);
    if (mesh.triangles.size() > options.max_triangles) {
      return absl::InvalidArgumentError(
          absl::StrCat("has more than ", options.max_triangles, " triangles; remove small parts"));
    }
  }
  if (mesh.triangles.empty()) return absl::InvalidArgumentError("has no face");
  const double edge_deflection = options.edge_deflection_ratio * std::sqrt(box.SquareExtent());
  AppendEdges(shape, first_points, kMetresPerUnit, edge_deflection, mesh);
  return mesh;
}

}  // namespace

absl::Status StepOptions::Validate() const {
  constexpr double kMaxTriangles = 1e8;  // indices have 32 bits
  EVPOSE_RETURN_IF_ERROR(CheckRange("StepOptions.deflection_ratio", deflection_ratio, 1e-7, 0.1));
  EVPOSE_RETURN_IF_ERROR(CheckRange("StepOptions.turn_rad", turn_rad, 1e-3, 1.5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("StepOptions.edge_deflection_ratio", edge_deflection_ratio, 1e-7, 0.1));
  return CheckRange("StepOptions.max_triangles", static_cast<double>(max_triangles), 1.0, kMaxTriangles);
}

absl::StatusOr<RawMesh> ReadStep(const std::string& path, const StepOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  try {
    const absl::StatusOr<TopoDS_Shape> shape = ReadShape(path);
    if (!shape.ok()) return shape.status();
    return Triangulate(*shape, options);
  } catch (const Standard_Failure& failure) {
    return absl::InvalidArgumentError(absl::StrCat("OpenCASCADE cannot convert it: ", failure.GetMessageString()));
  }
}

}  // namespace evpose::client
