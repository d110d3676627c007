// SPDX-License-Identifier: Apache-2.0
#include "server/models/mesh_message.h"

#include <array>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "core/base/status_macros.h"
#include "evpose/v1/mesh.pb.h"
#include "server/models/mesh_message_checks.h"

namespace evpose::server {
namespace {

static_assert(static_cast<int>(RegionShape::kPlane) + 1 == v1::MESH_SHAPE_PLANE);
static_assert(static_cast<int>(RegionShape::kFree) + 1 == v1::MESH_SHAPE_FREE);
static_assert(static_cast<int>(ExactEdge::Shape::kLine) + 1 == v1::MESH_CURVE_LINE);
static_assert(static_cast<int>(ExactEdge::Shape::kFree) + 1 == v1::MESH_CURVE_FREE);

using CornerNormals = std::vector<std::array<Eigen::Vector3f, 3>>;

v1::Vector3 ToProto(const Eigen::Vector3d& vector) {
  v1::Vector3 message;
  message.set_x(vector.x());
  message.set_y(vector.y());
  message.set_z(vector.z());
  return message;
}

Eigen::Vector3d FromProto(const v1::Vector3& message) { return {message.x(), message.y(), message.z()}; }

// Equal normals, which neighbouring triangles of a smooth surface have, are stored once, in the order of first use.
void AddNormals(const CornerNormals& corner_normals, v1::Mesh& message) {
  absl::flat_hash_map<std::array<float, 3>, uint32_t> numbers;
  for (const std::array<Eigen::Vector3f, 3>& corners : corner_normals) {
    for (const Eigen::Vector3f& normal : corners) {
      if (normal.isZero(0.0f)) {
        message.add_corner_normals(0);
        continue;
      }
      const auto [found, is_new] = numbers.try_emplace({normal.x(), normal.y(), normal.z()}, numbers.size() + 1);
      message.add_corner_normals(found->second);
      if (!is_new) continue;
      for (const float number : found->first) message.add_normals(number);
    }
  }
}

void AddFaces(const SmoothSurface& surface, v1::Mesh& message) {
  for (const SurfaceRegion& region : surface.regions) {
    v1::MeshFace& face = *message.add_faces();
    face.set_shape(static_cast<v1::MeshShape>(static_cast<int>(region.shape) + 1));
    face.set_inward(!region.is_convex);
    if (region.shape == RegionShape::kFree) continue;
    *face.mutable_point_m() = ToProto(region.point);
    *face.mutable_axis() = ToProto(region.axis);
    face.set_radius_m(region.radius_m);
    face.set_half_angle_rad(region.half_angle_rad);
  }
  message.mutable_triangle_faces()->Add(surface.region_of.begin(), surface.region_of.end());
}

void AddEdges(const std::vector<ExactEdge>& edges, v1::Mesh& message) {
  for (const ExactEdge& edge : edges) {
    v1::MeshEdge& added = *message.add_edges();
    added.set_curve(static_cast<v1::MeshCurve>(static_cast<int>(edge.shape) + 1));
    added.mutable_points()->Add(edge.points.begin(), edge.points.end());
    added.set_smooth(edge.is_smooth);
    if (edge.shape != ExactEdge::Shape::kCircle) continue;
    *added.mutable_centre_m() = ToProto(edge.circle.centre);
    *added.mutable_axis() = ToProto(edge.circle.axis);
    added.set_radius_m(edge.circle.radius_m);
  }
}

std::vector<ExactEdge> EdgesOf(const v1::Mesh& message) {
  std::vector<ExactEdge> edges;
  for (const v1::MeshEdge& stated : message.edges()) {
    ExactEdge& edge = edges.emplace_back();
    edge.shape = static_cast<ExactEdge::Shape>(stated.curve() - 1);
    edge.is_smooth = stated.smooth();
    edge.points.assign(stated.points().begin(), stated.points().end());
    if (edge.shape != ExactEdge::Shape::kCircle) continue;
    edge.circle = {FromProto(stated.centre_m()), FromProto(stated.axis()).normalized(), stated.radius_m()};
  }
  return edges;
}

CornerNormals NormalsOf(const v1::Mesh& message) {
  CornerNormals normals(static_cast<size_t>(message.corner_normals_size()) / 3);
  for (int i = 0; i < message.corner_normals_size(); ++i) {
    const int first = 3 * (static_cast<int>(message.corner_normals(i)) - 1);
    Eigen::Vector3f& normal = normals[static_cast<size_t>(i / 3)][static_cast<size_t>(i % 3)];
    normal.setZero();
    if (first < 0) continue;
    normal = Eigen::Vector3f(message.normals(first), message.normals(first + 1), message.normals(first + 2));
    normal /= normal.norm();
  }
  return normals;
}

SmoothSurface SurfaceOf(const v1::Mesh& message) {
  SmoothSurface surface;
  for (const v1::MeshFace& face : message.faces()) {
    SurfaceRegion& region = surface.regions.emplace_back();
    region.shape = static_cast<RegionShape>(face.shape() - 1);
    region.is_convex = !face.inward();
    if (region.shape == RegionShape::kFree) continue;
    region.point = FromProto(face.point_m());
    region.radius_m = face.radius_m();
    region.half_angle_rad = face.half_angle_rad();
    if (region.shape != RegionShape::kSphere) region.axis = FromProto(face.axis()).normalized();
  }
  surface.region_of.assign(message.triangle_faces().begin(), message.triangle_faces().end());
  return surface;
}

}  // namespace

std::string EncodeMesh(const RawMesh& mesh) {
  v1::Mesh message;
  message.mutable_positions()->Reserve(static_cast<int>(3 * mesh.points.size()));
  for (const Eigen::Vector3d& point : mesh.points) {
    for (const double coordinate : point) message.add_positions(static_cast<float>(coordinate));
  }
  message.mutable_triangles()->Reserve(static_cast<int>(3 * mesh.triangles.size()));
  for (const auto& triangle : mesh.triangles) {
    for (const uint32_t corner : triangle) message.add_triangles(corner);
  }
  for (const auto& [first, second] : mesh.lines) {
    message.add_lines(first);
    message.add_lines(second);
  }
  const bool has_faces = !mesh.exact_surface.empty();
  AddNormals(has_faces ? mesh.exact_surface.normals : mesh.corner_normals, message);
  if (has_faces) AddFaces(mesh.exact_surface, message);
  AddEdges(mesh.exact_edges, message);
  return message.SerializeAsString();
}

absl::StatusOr<RawMesh> ParseMesh(absl::Span<const uint8_t> bytes, size_t max_triangles) {
  v1::Mesh message;
  if (!message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) {
    return absl::InvalidArgumentError("is not a serialized Mesh");
  }
  message.DiscardUnknownFields();
  EVPOSE_RETURN_IF_ERROR(CheckMesh(message, max_triangles));
  RawMesh mesh;
  mesh.lines_are_all = false;
  mesh.points.reserve(static_cast<size_t>(message.positions_size()) / 3);
  for (int i = 0; i < message.positions_size(); i += 3) {
    mesh.points.push_back({message.positions(i), message.positions(i + 1), message.positions(i + 2)});
  }
  mesh.triangles.reserve(static_cast<size_t>(message.triangles_size()) / 3);
  for (int i = 0; i < message.triangles_size(); i += 3) {
    mesh.triangles.push_back({message.triangles(i), message.triangles(i + 1), message.triangles(i + 2)});
  }
  for (int i = 0; i < message.lines_size(); i += 2) mesh.lines.push_back({message.lines(i), message.lines(i + 1)});
  if (message.faces_size() == 0) {
    mesh.corner_normals = NormalsOf(message);
  } else {
    mesh.exact_surface = SurfaceOf(message);
    mesh.exact_surface.normals = NormalsOf(message);
    mesh.exact_edges = EdgesOf(message);
  }
  return mesh;
}

absl::StatusOr<ObjectModel> ParseModelFile(absl::Span<const uint8_t> bytes, ModelFormat format,
                                           const ModelOptions& options, ModelStepListener on_step) {
  if (format != ModelFormat::kMesh) return ParseObjectModel(bytes, format, options, on_step);
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(options.CheckSize(bytes.size()));
  on_step("reading the file");
  EVPOSE_ASSIGN_OR_RETURN(RawMesh mesh, ParseMesh(bytes, options.max_triangles));
  return BuildObjectModel(std::move(mesh), options, on_step);
}

}  // namespace evpose::server
