// SPDX-License-Identifier: Apache-2.0
#include "server/models/mesh_message_checks.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/string_view.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

using Floats = google::protobuf::RepeatedField<float>;
using Indices = google::protobuf::RepeatedField<uint32_t>;

// Largest difference between 1 and the length of a unit vector: vectors of 8-bit numbers, scaled, have it.
constexpr double kUnitTolerance = 0.01;

absl::Status FieldError(absl::string_view field, absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("Mesh.", field, ": ", what));
}

absl::Status ElementError(absl::string_view field, int i, absl::string_view what) {
  return FieldError(absl::StrCat(field, "[", i, "]"), what);
}

absl::Status CheckMultiple(absl::string_view field, int size, int divisor) {
  if (size % divisor == 0) return absl::OkStatus();
  return FieldError(field, absl::StrFormat("has %d numbers, which is no multiple of %d", size, divisor));
}

absl::Status CheckFinite(absl::string_view field, const Floats& numbers) {
  for (int i = 0; i < numbers.size(); ++i) {
    if (!std::isfinite(numbers[i])) return ElementError(field, i, "is not finite");
  }
  return absl::OkStatus();
}

// Indices are below `count`.
absl::Status CheckIndices(absl::string_view field, const Indices& indices, int count, absl::string_view of) {
  for (int i = 0; i < indices.size(); ++i) {
    if (indices[i] < static_cast<uint32_t>(count)) continue;
    return ElementError(field, i, absl::StrFormat("is %u, but there are %d %s", indices[i], count, of));
  }
  return absl::OkStatus();
}

absl::Status CheckUnit(absl::string_view field, double x, double y, double z) {
  const double norm = std::sqrt(x * x + y * y + z * z);
  if (std::abs(norm - 1.0) <= kUnitTolerance) return absl::OkStatus();  // false for NaN
  return FieldError(field, absl::StrFormat("is not a unit vector: its norm is %.4g; normalize it", norm));
}

absl::Status CheckCount(absl::string_view field, int count, size_t most, absl::string_view of) {
  if (static_cast<size_t>(count) <= most) return absl::OkStatus();
  return FieldError(field, absl::StrFormat("has %d %s; at most %d: simplify the model", count, of, most));
}

absl::Status CheckGeometry(const v1::Mesh& mesh, size_t max_triangles) {
  EVPOSE_RETURN_IF_ERROR(CheckMultiple("positions", mesh.positions_size(), 3));
  EVPOSE_RETURN_IF_ERROR(CheckMultiple("triangles", mesh.triangles_size(), 3));
  EVPOSE_RETURN_IF_ERROR(CheckMultiple("lines", mesh.lines_size(), 2));
  EVPOSE_RETURN_IF_ERROR(CheckCount("triangles", mesh.triangles_size() / 3, max_triangles, "triangles"));
  EVPOSE_RETURN_IF_ERROR(CheckCount("lines", mesh.lines_size() / 2, max_triangles, "lines"));
  EVPOSE_RETURN_IF_ERROR(CheckFinite("positions", mesh.positions()));
  const int num_points = mesh.positions_size() / 3;
  EVPOSE_RETURN_IF_ERROR(CheckIndices("triangles", mesh.triangles(), num_points, "points"));
  return CheckIndices("lines", mesh.lines(), num_points, "points");
}

absl::Status CheckNormals(const v1::Mesh& mesh) {
  EVPOSE_RETURN_IF_ERROR(CheckMultiple("normals", mesh.normals_size(), 3));
  for (int i = 0; i < mesh.normals_size(); i += 3) {
    EVPOSE_RETURN_IF_ERROR(
        CheckUnit(absl::StrCat("normals[", i / 3, "]"), mesh.normals(i), mesh.normals(i + 1), mesh.normals(i + 2)));
  }
  if (mesh.corner_normals_size() != 0 && mesh.corner_normals_size() != mesh.triangles_size()) {
    return FieldError("corner_normals", absl::StrFormat("has %d numbers, but triangles has %d",
                                                        mesh.corner_normals_size(), mesh.triangles_size()));
  }
  return CheckIndices("corner_normals", mesh.corner_normals(), mesh.normals_size() / 3 + 1, "normals, counted from 1");
}

absl::Status CheckFace(const v1::MeshFace& face, int i) {
  const v1::Vector3& point = face.point_m();
  if (!v1::MeshShape_IsValid(face.shape()) || face.shape() == v1::MESH_SHAPE_UNSPECIFIED) {
    return ElementError("faces", i, "its shape is missing or unknown");
  }
  if (face.shape() == v1::MESH_SHAPE_FREE) return absl::OkStatus();
  if (!face.has_point_m() || !std::isfinite(point.x()) || !std::isfinite(point.y()) || !std::isfinite(point.z())) {
    return ElementError("faces", i, "point_m is missing or not finite");
  }
  const v1::Vector3& axis = face.axis();
  if (face.shape() != v1::MESH_SHAPE_SPHERE) {
    EVPOSE_RETURN_IF_ERROR(CheckUnit(absl::StrCat("faces[", i, "].axis"), axis.x(), axis.y(), axis.z()));
  }
  const bool has_radius = face.shape() == v1::MESH_SHAPE_CYLINDER || face.shape() == v1::MESH_SHAPE_SPHERE;
  if (has_radius && !(face.radius_m() > 0.0 && std::isfinite(face.radius_m()))) {
    return ElementError("faces", i, "radius_m is not above 0 and finite");
  }
  const double angle = face.half_angle_rad();
  if (face.shape() == v1::MESH_SHAPE_CONE && !(angle > 0.0 && angle < std::numbers::pi / 2.0)) {
    return ElementError("faces", i, "half_angle_rad is not between 0 and pi / 2");
  }
  return absl::OkStatus();
}

absl::Status CheckFaces(const v1::Mesh& mesh) {
  const int num_triangles = mesh.triangles_size() / 3;
  if (mesh.faces_size() == 0 && mesh.triangle_faces_size() == 0) return absl::OkStatus();
  EVPOSE_RETURN_IF_ERROR(CheckCount("faces", mesh.faces_size(), static_cast<size_t>(num_triangles), "faces"));
  for (int i = 0; i < mesh.faces_size(); ++i) EVPOSE_RETURN_IF_ERROR(CheckFace(mesh.faces(i), i));
  if (mesh.triangle_faces_size() != num_triangles) {
    return FieldError("triangle_faces", absl::StrFormat("has %d numbers, but there are %d triangles",
                                                        mesh.triangle_faces_size(), num_triangles));
  }
  EVPOSE_RETURN_IF_ERROR(CheckIndices("triangle_faces", mesh.triangle_faces(), mesh.faces_size(), "faces"));
  if (mesh.corner_normals_size() != mesh.triangles_size()) {
    return FieldError("corner_normals", "is empty; with faces, each corner has a normal");
  }
  for (int i = 0; i < mesh.corner_normals_size(); ++i) {
    if (mesh.corner_normals(i) == 0)
      return ElementError("corner_normals", i, "is 0; with faces, each corner has a normal");
  }
  return absl::OkStatus();
}

absl::Status CheckCircle(const v1::MeshEdge& edge, const Floats& positions, int i) {
  // Relative to the radius. Single precision and the tolerance of CAD programs are below it.
  constexpr double kMaxDistance = 0.01;
  const v1::Vector3 &centre = edge.centre_m(), &axis = edge.axis();
  if (!edge.has_centre_m() || !std::isfinite(centre.x()) || !std::isfinite(centre.y()) || !std::isfinite(centre.z())) {
    return ElementError("edges", i, "centre_m is missing or not finite");
  }
  EVPOSE_RETURN_IF_ERROR(CheckUnit(absl::StrCat("edges[", i, "].axis"), axis.x(), axis.y(), axis.z()));
  if (!(edge.radius_m() > 0.0 && std::isfinite(edge.radius_m()))) {
    return ElementError("edges", i, "radius_m is not above 0 and finite");
  }
  for (const uint32_t point : edge.points()) {
    const int first = 3 * static_cast<int>(point);
    const double x = positions[first] - centre.x(), y = positions[first + 1] - centre.y(),
                 z = positions[first + 2] - centre.z();
    const double height = x * axis.x() + y * axis.y() + z * axis.z();
    const double across = std::sqrt(std::max(0.0, x * x + y * y + z * z - height * height)) - edge.radius_m();
    if (std::sqrt(height * height + across * across) <= kMaxDistance * edge.radius_m()) continue;  // false for NaN
    return ElementError("edges", i, absl::StrFormat("its point %u is not on the circle", point));
  }
  return absl::OkStatus();
}

absl::Status CheckEdges(const v1::Mesh& mesh, size_t max_triangles) {
  // The number of corners of triangles, because each may be on an edge.
  const size_t max_points = 3 * max_triangles;
  if (mesh.edges_size() == 0) return absl::OkStatus();
  if (mesh.faces_size() == 0) return FieldError("edges", "are given without faces");
  // Each has a side of a triangle, at least.
  EVPOSE_RETURN_IF_ERROR(CheckCount("edges", mesh.edges_size(), static_cast<size_t>(mesh.triangles_size()), "edges"));
  size_t num_points = 0;
  for (int i = 0; i < mesh.edges_size(); ++i) {
    const v1::MeshEdge& edge = mesh.edges(i);
    if (!v1::MeshCurve_IsValid(edge.curve()) || edge.curve() == v1::MESH_CURVE_UNSPECIFIED) {
      return ElementError("edges", i, "its curve is missing or unknown");
    }
    if (edge.points_size() < 2) return ElementError("edges", i, "has less than two points");
    num_points += static_cast<size_t>(edge.points_size());
    if (num_points > max_points) {
      return FieldError("edges", absl::StrFormat("have more than %d points; simplify the model", max_points));
    }
    const std::string field = absl::StrCat("edges[", i, "].points");
    EVPOSE_RETURN_IF_ERROR(CheckIndices(field, edge.points(), mesh.positions_size() / 3, "points"));
    if (edge.curve() == v1::MESH_CURVE_CIRCLE) EVPOSE_RETURN_IF_ERROR(CheckCircle(edge, mesh.positions(), i));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CheckMesh(const v1::Mesh& mesh, size_t max_triangles) {
  EVPOSE_RETURN_IF_ERROR(CheckGeometry(mesh, max_triangles));
  EVPOSE_RETURN_IF_ERROR(CheckNormals(mesh));
  EVPOSE_RETURN_IF_ERROR(CheckFaces(mesh));
  return CheckEdges(mesh, max_triangles);
}

}  // namespace evpose::server
