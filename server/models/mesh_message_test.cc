// SPDX-License-Identifier: Apache-2.0
#include "server/models/mesh_message.h"

#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "core/base/byte_order.h"
#include "evpose/v1/mesh.pb.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace evpose::server {
namespace {

using testing::HasSubstr;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

absl::StatusOr<RawMesh> Parse(const v1::Mesh& mesh, size_t max_triangles = 100) {
  const std::string bytes = mesh.SerializeAsString();
  return ParseMesh(AsBytes(bytes), max_triangles);
}

// A tetrahedron with a painted line, one region per triangle: a plane, a cylinder, a cone and a free surface.
RawMesh Tetrahedron() {
  RawMesh mesh;
  mesh.lines_are_all = false;
  mesh.points = {{0, 0, 0}, {0.5, 0, 0}, {0, 0.25, 0}, {0, 0, 1}};
  mesh.triangles = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};
  mesh.lines = {{0, 3}};
  SmoothSurface& surface = mesh.exact_surface;
  surface.region_of = {0, 1, 2, 3};
  for (int i = 0; i < 4; ++i) {
    surface.normals.push_back({Eigen::Vector3f::UnitX(), Eigen::Vector3f::UnitY(), -Eigen::Vector3f::UnitZ()});
  }
  surface.regions = {
      {.shape = RegionShape::kPlane, .point = {0, 0, 0}, .axis = -Eigen::Vector3d::UnitZ()},
      {.shape = RegionShape::kCylinder,
       .point = {1, 2, 3},
       .axis = Eigen::Vector3d::UnitX(),
       .radius_m = 0.125,
       .is_convex = false},
      {.shape = RegionShape::kCone, .point = {3, 2, 1}, .axis = Eigen::Vector3d::UnitY(), .half_angle_rad = 0.5},
      {.shape = RegionShape::kFree}};
  return mesh;
}

// The same with exact edges: a smooth line, an arc and a free curve.
RawMesh TetrahedronWithEdges() {
  RawMesh mesh = Tetrahedron();
  mesh.exact_edges = {
      {.shape = ExactEdge::Shape::kLine, .is_smooth = true, .points = {0, 1}},
      {.shape = ExactEdge::Shape::kCircle, .circle = {{0.5, 0.25, 0}, Eigen::Vector3d::UnitZ(), 0.5}, .points = {2, 2}},
      {.shape = ExactEdge::Shape::kFree, .points = {1, 0, 3}}};
  return mesh;
}

v1::Mesh Message(const RawMesh& mesh) {
  v1::Mesh message;
  EXPECT_TRUE(message.ParseFromString(EncodeMesh(mesh)));
  return message;
}

TEST(MeshMessageTest, AMeshWithExactFacesIsReadAsItWasWritten) {
  const RawMesh mesh = Tetrahedron();
  const absl::StatusOr<RawMesh> read = Parse(Message(mesh));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->points, mesh.points);
  EXPECT_EQ(read->triangles, mesh.triangles);
  EXPECT_EQ(read->lines, mesh.lines);
  EXPECT_FALSE(read->lines_are_all);
  EXPECT_TRUE(read->corner_normals.empty());
  EXPECT_EQ(read->exact_surface.region_of, mesh.exact_surface.region_of);
  EXPECT_EQ(read->exact_surface.normals, mesh.exact_surface.normals);
  ASSERT_EQ(read->exact_surface.regions.size(), 4u);
  for (size_t i = 0; i < 4; ++i) {
    const SurfaceRegion &was = mesh.exact_surface.regions[i], &is = read->exact_surface.regions[i];
    EXPECT_EQ(is.shape, was.shape);
    EXPECT_EQ(is.point, was.point);
    EXPECT_EQ(is.axis, was.axis);
    EXPECT_EQ(is.radius_m, was.radius_m);
    EXPECT_EQ(is.half_angle_rad, was.half_angle_rad);
    EXPECT_EQ(is.is_convex, was.is_convex);
  }
}

TEST(MeshMessageTest, ExactEdgesAreReadAsTheyWereWritten) {
  const RawMesh mesh = TetrahedronWithEdges();
  const absl::StatusOr<RawMesh> read = Parse(Message(mesh));
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_EQ(read->exact_edges.size(), 3u);
  for (size_t i = 0; i < 3; ++i) {
    const ExactEdge &was = mesh.exact_edges[i], &is = read->exact_edges[i];
    EXPECT_EQ(is.shape, was.shape);
    EXPECT_EQ(is.is_smooth, was.is_smooth);
    EXPECT_EQ(is.points, was.points);
    EXPECT_EQ(is.circle.centre, was.circle.centre);
    EXPECT_EQ(is.circle.axis, was.circle.axis);
    EXPECT_EQ(is.circle.radius_m, was.circle.radius_m);
  }
}

TEST(MeshMessageTest, NormalsOfCornersMayBeMissingAndAreStoredOnce) {
  RawMesh mesh = Tetrahedron();
  mesh.exact_surface = {};
  const Eigen::Vector3f none = Eigen::Vector3f::Zero();
  mesh.corner_normals = {{Eigen::Vector3f::UnitX(), none, Eigen::Vector3f::UnitX()},
                         {none, none, none},
                         {none, none, none},
                         {Eigen::Vector3f::UnitX(), Eigen::Vector3f::UnitY(), none}};
  const v1::Mesh message = Message(mesh);
  EXPECT_EQ(message.normals_size(), 6);
  const absl::StatusOr<RawMesh> read = Parse(message);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->corner_normals, mesh.corner_normals);
  EXPECT_TRUE(read->exact_surface.empty());
}

TEST(MeshMessageTest, ErrorsNameTheFieldAndTheIndex) {
  using Spoil = std::function<void(v1::Mesh&)>;
  const std::vector<std::pair<std::string, Spoil>> cases = {
      {"Mesh.positions: has 13 numbers, which is no multiple of 3", [](v1::Mesh& m) { m.add_positions(0); }},
      {"Mesh.positions[4]: is not finite", [](v1::Mesh& m) { m.set_positions(4, kNan); }},
      {"Mesh.triangles: has 11 numbers", [](v1::Mesh& m) { m.mutable_triangles()->RemoveLast(); }},
      {"Mesh.triangles[2]: is 4, but there are 4 points", [](v1::Mesh& m) { m.set_triangles(2, 4); }},
      {"Mesh.triangles[0]: is 4294967295", [](v1::Mesh& m) { m.set_triangles(0, ~0u); }},
      {"Mesh.lines: has 3 numbers", [](v1::Mesh& m) { m.add_lines(0); }},
      {"Mesh.lines[1]: is 7", [](v1::Mesh& m) { m.set_lines(1, 7); }},
      {"Mesh.normals[1]: is not a unit vector: its norm is 2", [](v1::Mesh& m) { m.set_normals(4, 2); }},
      {"Mesh.normals[0]: is not a unit vector: its norm is", [](v1::Mesh& m) { m.set_normals(0, kNan); }},
      {"Mesh.corner_normals: has 11 numbers", [](v1::Mesh& m) { m.mutable_corner_normals()->RemoveLast(); }},
      {"Mesh.corner_normals[5]: is 4", [](v1::Mesh& m) { m.set_corner_normals(5, 4); }},
      {"Mesh.corner_normals[5]: is 0; with faces", [](v1::Mesh& m) { m.set_corner_normals(5, 0); }},
      {"Mesh.corner_normals: is empty; with faces", [](v1::Mesh& m) { m.clear_corner_normals(); }},
      {"Mesh.triangle_faces: has 0 numbers", [](v1::Mesh& m) { m.clear_triangle_faces(); }},
      {"Mesh.triangle_faces[0]: is 0, but there are 0 faces", [](v1::Mesh& m) { m.clear_faces(); }},
      {"Mesh.faces: has 5 faces; at most 4", [](v1::Mesh& m) { m.add_faces(); }},
      {"Mesh.faces[0]: its shape is missing", [](v1::Mesh& m) { m.mutable_faces(0)->clear_shape(); }},
      {"Mesh.faces[0]: its shape is missing", [](v1::Mesh& m) { m.mutable_faces(0)->set_shape(v1::MeshShape(77)); }},
      {"Mesh.faces[0]: point_m is missing", [](v1::Mesh& m) { m.mutable_faces(0)->clear_point_m(); }},
      {"Mesh.faces[1].axis: is not a unit vector: its norm is 0; normalize it",
       [](v1::Mesh& m) { m.mutable_faces(1)->clear_axis(); }},
      {"Mesh.faces[1]: radius_m", [](v1::Mesh& m) { m.mutable_faces(1)->set_radius_m(kNan); }},
      {"Mesh.faces[1]: radius_m", [](v1::Mesh& m) { m.mutable_faces(1)->set_radius_m(INFINITY); }},
      {"Mesh.faces[2]: half_angle_rad", [](v1::Mesh& m) { m.mutable_faces(2)->set_half_angle_rad(1.6); }},
      {"Mesh.edges: are given without faces",
       [](v1::Mesh& m) {
         m.clear_faces();
         m.clear_triangle_faces();
       }},
      {"Mesh.edges: has 13 edges; at most 12",
       [](v1::Mesh& m) {
         while (m.edges_size() < 13) m.add_edges();
       }},
      {"Mesh.edges[0]: its curve is missing", [](v1::Mesh& m) { m.mutable_edges(0)->clear_curve(); }},
      {"Mesh.edges[0]: its curve is missing", [](v1::Mesh& m) { m.mutable_edges(0)->set_curve(v1::MeshCurve(9)); }},
      {"Mesh.edges[2]: has less than two points", [](v1::Mesh& m) { m.mutable_edges(2)->clear_points(); }},
      {"Mesh.edges[0].points[1]: is 4, but there are 4", [](v1::Mesh& m) { m.mutable_edges(0)->set_points(1, 4); }},
      {"Mesh.edges[1]: centre_m is missing", [](v1::Mesh& m) { m.mutable_edges(1)->clear_centre_m(); }},
      {"Mesh.edges[1]: centre_m is missing", [](v1::Mesh& m) { m.mutable_edges(1)->mutable_centre_m()->set_x(kNan); }},
      {"Mesh.edges[1].axis: is not a unit vector: its norm is 0; normalize it",
       [](v1::Mesh& m) { m.mutable_edges(1)->clear_axis(); }},
      {"Mesh.edges[1]: radius_m", [](v1::Mesh& m) { m.mutable_edges(1)->set_radius_m(INFINITY); }},
      {"Mesh.edges[1]: its point 2 is not on the circle", [](v1::Mesh& m) { m.mutable_edges(1)->set_radius_m(0.4); }},
  };
  for (const auto& [error, spoil] : cases) {
    v1::Mesh message = Message(TetrahedronWithEdges());
    spoil(message);
    const absl::Status status = Parse(message).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << error;
    EXPECT_THAT(std::string(status.message()), HasSubstr(error));
  }
}

TEST(MeshMessageTest, LimitsAndMalformedBytesAreErrors) {
  const v1::Mesh message = Message(Tetrahedron());
  EXPECT_TRUE(Parse(message, 4).ok());
  EXPECT_THAT(std::string(Parse(message, 3).status().message()),
              HasSubstr("Mesh.triangles: has 4 triangles; at most 3: simplify"));
  v1::Mesh long_edge = Message(TetrahedronWithEdges());
  for (int i = 0; i < 12; ++i) long_edge.mutable_edges(2)->add_points(0);
  EXPECT_THAT(std::string(Parse(long_edge, 4).status().message()), HasSubstr("Mesh.edges: have more than 12 points"));
  const std::string bytes = message.SerializeAsString();
  size_t refused = 0;
  for (size_t size = 1; size < bytes.size(); ++size)
    refused += ParseMesh(AsBytes(bytes.substr(0, size)), 4).ok() ? 0 : 1;
  EXPECT_GT(refused, bytes.size() / 2) << "a cut message has incomplete lists";
  EXPECT_THAT(std::string(ParseMesh(AsBytes("\xff"), 4).status().message()), HasSubstr("is not a serialized Mesh"));
}

// A closed box with sides of 1, 2 and 3, to be read in another unit.
RawMesh Box() {
  RawMesh mesh;
  for (int i = 0; i < 8; ++i) mesh.points.push_back({i & 1 ? 1.0 : 0.0, i & 2 ? 2.0 : 0.0, i & 4 ? 3.0 : 0.0});
  for (const auto& [a, b, c, d] :
       {std::array{0u, 2u, 3u, 1u}, std::array{4u, 5u, 7u, 6u}, std::array{0u, 1u, 5u, 4u}, std::array{2u, 6u, 7u, 3u},
        std::array{0u, 4u, 6u, 2u}, std::array{1u, 3u, 7u, 5u}}) {
    mesh.triangles.push_back({a, b, c});
    mesh.triangles.push_back({a, c, d});
  }
  return mesh;
}

TEST(ParseModelFileTest, PaintedLinesAreLinesBesideTheCreases) {
  RawMesh mesh = Box();
  const std::string plain = EncodeMesh(mesh);
  const absl::StatusOr<ObjectModel> without = ParseModelFile(AsBytes(plain), ModelFormat::kMesh, {});
  ASSERT_TRUE(without.ok()) << without.status();
  EXPECT_EQ(without->lines.size(), 12u);
  mesh.points.push_back({0.5, 0.5, 3.0});
  mesh.points.push_back({0.5, 1.5, 3.0});
  mesh.lines = {{8, 9}};
  const std::string painted = EncodeMesh(mesh);
  const absl::StatusOr<ObjectModel> with =
      ParseModelFile(AsBytes(painted), ModelFormat::kMesh, {.metres_per_unit = 0.5});
  ASSERT_TRUE(with.ok()) << with.status();
  EXPECT_EQ(with->lines.size(), 13u);
  EXPECT_NEAR(with->diameter_m, 0.5 * std::sqrt(14.0), 1e-9);
}

TEST(ParseModelFileTest, OtherFormatsAreThoseOfParseObjectModel) {
  const std::string obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
  EXPECT_EQ(ParseModelFile(AsBytes(obj), ModelFormat::kObj, {})->lines.size(), 3u);
  EXPECT_EQ(ParseModelFile({}, ModelFormat::kMesh, {}).status().message(), "the model file is empty");
  ModelOptions small;
  small.max_bytes = 10;
  EXPECT_THAT(std::string(ParseModelFile(AsBytes(EncodeMesh(Box())), ModelFormat::kMesh, small).status().message()),
              HasSubstr("more than the limit of 10"));
}

}  // namespace
}  // namespace evpose::server
