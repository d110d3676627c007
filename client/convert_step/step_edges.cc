// SPDX-License-Identifier: Apache-2.0
#include "client/convert_step/step_edges.h"

#include <BRepAdaptor_Curve.hxx>
#include <BRep_Tool.hxx>
#include <Eigen/Geometry>
#include <GeomAbs_CurveType.hxx>
#include <Poly_PolygonOnTriangulation.hxx>
#include <Poly_Triangulation.hxx>
#include <TopExp.hxx>
#include <TopExp_Explorer.hxx>
#include <TopLoc_Location.hxx>
#include <TopTools_IndexedDataMapOfShapeListOfShape.hxx>
#include <TopTools_IndexedMapOfShape.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Edge.hxx>
#include <TopoDS_Face.hxx>
#include <algorithm>
#include <cmath>
#include <gp_Circ.hxx>
#include <numbers>
#include <vector>

#include "client/convert_step/face_surface.h"
#include "client/convert_step/step_shape.h"
#include "core/numerics/statistics.h"

namespace evpose::client {
namespace {

// Two faces continue each other if the angle between their normals, the median over the points of their common edge, is
// below this one (10 degrees). The same bound holds for the normals that a model file states (core/mesh/README.md,
// section 8).
constexpr double kMaxSmoothAngle = 10.0 * std::numbers::pi / 180.0;
// Largest number of pieces into which a segment of a free curve is divided. The segments are those of the
// triangulation, which turn by 0.3 rad at most (StepOptions::turn_rad).
constexpr double kMaxPieces = 16.0;
// Largest distance between a node of an edge and its circle, relative to the radius; a fifth of what a server accepts.
constexpr double kMaxFromCircle = 0.002;

Eigen::Vector3d Vector(const gp_Pnt& point) { return {point.X(), point.Y(), point.Z()}; }
Eigen::Vector3d Vector(const gp_Dir& direction) { return {direction.X(), direction.Y(), direction.Z()}; }

// An edge in the triangulation of one of its faces.
struct EdgeInFace {
  TopoDS_Face face;
  opencascade::handle<Poly_Triangulation> mesh;
  opencascade::handle<Poly_PolygonOnTriangulation> polygon;
};

EdgeInFace Locate(const TopoDS_Edge& edge, const TopoDS_Face& face) {
  EdgeInFace located;
  TopLoc_Location location;
  located.face = face;
  located.mesh = BRep_Tool::Triangulation(face, location);
  if (!located.mesh.IsNull()) located.polygon = BRep_Tool::PolygonOnTriangulation(edge, located.mesh, location);
  return located;
}

std::vector<Eigen::Vector3d> NormalsAlong(const EdgeInFace& at) {
  std::vector<Eigen::Vector3d> normals;
  if (!at.mesh->HasUVNodes()) return normals;
  const FaceSurface surface(at.face);
  for (int i = 1; i <= at.polygon->NbNodes(); ++i) {
    const gp_Pnt2d uv = at.mesh->UVNode(at.polygon->Node(i));
    normals.push_back(surface.Normal({uv.X(), uv.Y()}));
  }
  return normals;
}

// The number of faces that each edge bounds in its own direction, less that of the faces that it bounds in the other.
// It is zero if the outer sides of the two faces at the edge continue each other.
TopTools_DataMapOfShapeInteger DirectionSums(const TopoDS_Shape& shape) {
  TopTools_DataMapOfShapeInteger sums;
  TopTools_IndexedMapOfShape faces;
  TopExp::MapShapes(shape, TopAbs_FACE, faces);
  for (int f = 1; f <= faces.Extent(); ++f) {
    for (TopExp_Explorer edges(faces(f), TopAbs_EDGE); edges.More(); edges.Next()) {
      const int direction = edges.Current().Orientation() == TopAbs_REVERSED ? -1 : 1;
      if (int* sum = sums.ChangeSeek(edges.Current())) {
        *sum += direction;
      } else {
        sums.Bind(edges.Current(), direction);
      }
    }
  }
  return sums;
}

// Whether two faces continue each other at their common edge. `are_opposite`: the outer side of one continues the inner
// side of the other, as in a surface of which some faces are turned.
bool AreSmooth(const EdgeInFace& a, const EdgeInFace& b, bool are_opposite) {
  const std::vector<Eigen::Vector3d> of_a = NormalsAlong(a), of_b = NormalsAlong(b);
  std::vector<double> cosines;
  for (size_t i = 0; i < std::min(of_a.size(), of_b.size()); ++i) {
    // A surface has no normal at a pole.
    if (!of_a[i].isZero(0.0) && !of_b[i].isZero(0.0))
      cosines.push_back((are_opposite ? -1.0 : 1.0) * of_a[i].dot(of_b[i]));
  }
  if (cosines.empty()) return false;
  return UpperMedian(cosines) > std::cos(kMaxSmoothAngle);
}

ExactEdge DescribeCurve(const BRepAdaptor_Curve& curve, double scale) {
  ExactEdge edge;
  if (curve.GetType() == GeomAbs_Line) edge.shape = ExactEdge::Shape::kLine;
  if (curve.GetType() != GeomAbs_Circle) return edge;
  const gp_Circ circle = curve.Circle();
  edge.shape = ExactEdge::Shape::kCircle;
  edge.circle = {scale * Vector(circle.Location()), Vector(circle.Axis().Direction()), scale * circle.Radius()};
  return edge;
}

// Whether the nodes of an edge are on a circle. The ends may be as far from it as the tolerance of the vertices.
bool IsOnCircle(const EdgeCircle& circle, const Poly_PolygonOnTriangulation& polygon, int first, const RawMesh& mesh) {
  for (int i = 1; i <= polygon.NbNodes(); ++i) {
    // In single precision, as in the message.
    const Eigen::Vector3d point =
        mesh.points[static_cast<size_t>(first + polygon.Node(i) - 1)].cast<float>().cast<double>();
    const double height = circle.axis.dot(point - circle.centre);
    const double across = (point - circle.centre - height * circle.axis).norm() - circle.radius_m;
    if (!(std::hypot(height, across) <= kMaxFromCircle * circle.radius_m)) return false;
  }
  return true;
}

// Appends points of a curve between two parameters.
void AppendBetween(const BRepAdaptor_Curve& curve, double from, double to, double scale, double deflection,
                   ExactEdge& edge, RawMesh& mesh) {
  const Eigen::Vector3d begin = Vector(curve.Value(from)), end = Vector(curve.Value(to));
  const double sagitta = (Vector(curve.Value(0.5 * (from + to))) - 0.5 * (begin + end)).norm();
  // The sagitta of n pieces is smaller by n^2.
  const double pieces = std::clamp(std::ceil(std::sqrt(sagitta / deflection)), 1.0, kMaxPieces);
  for (int i = 1; i < static_cast<int>(pieces); ++i) {
    edge.points.push_back(static_cast<uint32_t>(mesh.points.size()));
    mesh.points.push_back(scale * Vector(curve.Value(from + i / pieces * (to - from))));
  }
}

}  // namespace

void AppendEdges(const TopoDS_Shape& shape, const TopTools_DataMapOfShapeInteger& first_points, double scale,
                 double deflection, RawMesh& mesh) {
  const TopTools_IndexedDataMapOfShapeListOfShape faces_of = FacesOfEdges(shape);
  const TopTools_DataMapOfShapeInteger directions = DirectionSums(shape);
  for (int e = 1; e <= faces_of.Extent(); ++e) {
    const TopoDS_Edge& edge = TopoDS::Edge(faces_of.FindKey(e));
    if (BRep_Tool::Degenerated(edge)) continue;  // a pole
    std::vector<EdgeInFace> at;
    for (const TopoDS_Shape& face : faces_of(e)) at.push_back(Locate(edge, TopoDS::Face(face)));
    if (IsSeam(edge, faces_of(e))) continue;
    std::erase_if(at, [](const EdgeInFace& in) { return in.polygon.IsNull(); });  // faces without triangles
    if (at.empty() || at.size() > 2) continue;
    const BRepAdaptor_Curve curve(edge);
    ExactEdge exact = DescribeCurve(curve, scale);
    exact.is_smooth = at.size() == 2 && AreSmooth(at[0], at[1], directions.Find(edge) != 0);
    const Poly_PolygonOnTriangulation& polygon = *at[0].polygon;
    const int first = first_points.Find(at[0].face);
    if (exact.shape == ExactEdge::Shape::kCircle && !IsOnCircle(exact.circle, polygon, first, mesh)) {
      exact.shape = ExactEdge::Shape::kFree;
    }
    for (int i = 1; i <= polygon.NbNodes(); ++i) {
      if (i > 1 && exact.shape == ExactEdge::Shape::kFree && polygon.HasParameters()) {
        AppendBetween(curve, polygon.Parameter(i - 1), polygon.Parameter(i), scale, deflection, exact, mesh);
      }
      exact.points.push_back(static_cast<uint32_t>(first + polygon.Node(i) - 1));
    }
    // The two ends of a closed edge may be two nodes at one place.
    if (exact.points.size() > 2 && mesh.points[exact.points.front()] == mesh.points[exact.points.back()]) {
      exact.points.back() = exact.points.front();
    }
    if (exact.points.size() >= 2) mesh.exact_edges.push_back(std::move(exact));
  }
}

}  // namespace evpose::client
