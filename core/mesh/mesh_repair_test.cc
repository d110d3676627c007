// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_repair.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <iterator>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "core/mesh/loading/model_readers.h"
#include "core/mesh/mesh_topology.h"
#include "core/mesh/meshes_testing.h"
#include "core/mesh/surface_regions.h"
#include "tests/data/test_data.h"

namespace evpose {
namespace {

using Eigen::Vector3d;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

RawMesh UnitBox() {
  RawMesh mesh;
  AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
  return mesh;
}

std::vector<std::string> NoticesOf(const RepairReport& report) {
  std::vector<std::string> notices;
  DescribeRepair(report, notices);
  return notices;
}

TEST(RepairMeshTest, SoundMeshesHaveTheSamePointsAndTrianglesInTheSameOrder) {
  RawMesh two_sides;
  AddPlate(Vector3d::Zero(), Vector3d::UnitX(), Vector3d::UnitY(), two_sides);
  AddPlate(Vector3d::Zero(), Vector3d::UnitY(), Vector3d::UnitX(), two_sides);
  // A box with a smaller one on its top and two plates of two sides beside it, one at the end of the other.
  RawMesh spacecraft = UnitBox();
  AddBox({0.3, 0.4, 1.0}, {0.2, 0.2, 0.5}, spacecraft);
  for (const auto& [x, y, width, height] : {std::array{1.0, 0.45, 0.2, 0.1}, std::array{1.2, 0.0, 2.0, 1.0}}) {
    AddPlate({x, y, 0.5}, width * Vector3d::UnitX(), height * Vector3d::UnitY(), spacecraft);
    AddPlate({x, y, 0.5}, height * Vector3d::UnitY(), width * Vector3d::UnitX(), spacecraft);
  }
  for (const RawMesh& mesh : {UnitBox(), two_sides, spacecraft}) {
    RawMesh repaired = mesh, expected = mesh;
    const RepairReport report = RepairMesh(repaired);
    MergePoints(1e-6, expected);
    EXPECT_EQ(repaired.points, expected.points);
    EXPECT_EQ(repaired.triangles, expected.triangles);
    EXPECT_TRUE(report.is_closed && report.is_oriented && report.is_complete);
    EXPECT_THAT(NoticesOf(report), IsEmpty());
  }
}

TEST(RepairMeshTest, CornersThatDifferByAMillionthAreOne) {
  std::mt19937 random(1);
  RawMesh mesh = UnitBox();
  for (Vector3d& point : mesh.points) {
    for (double& value : point) value += 1e-6 * (static_cast<double>(random() % 2001) / 1000.0 - 1.0);
  }
  const RepairReport report = RepairMesh(mesh);
  EXPECT_THAT(mesh.points, SizeIs(8));
  EXPECT_THAT(mesh.triangles, SizeIs(12));
  EXPECT_EQ(report.merged_points, 28u);
  EXPECT_TRUE(report.is_closed);
  EXPECT_EQ(report.split_edges + report.degenerate_triangles, 0u);
}

TEST(RepairMeshTest, PointsMergeWithTheFirstAndNotInChains) {
  // Each point is within the tolerance of the one before, the third and the fourth are not within that of the first.
  RawMesh mesh;
  mesh.points = {{0, 0, 0}, {0.8e-5, 0, 0}, {1.6e-5, 0, 0}, {2.4e-5, 0, 0}, {1, 0, 0}};
  mesh.lines = {{0, 4}, {1, 4}, {2, 4}, {3, 4}, {0, 1}, {2, 3}};
  const RepairReport report = RepairMesh(mesh);
  EXPECT_THAT(mesh.points, ElementsAre(Vector3d(0, 0, 0), Vector3d(1.6e-5, 0, 0), Vector3d(1, 0, 0)));
  EXPECT_EQ(report.merged_points, 2u);
  EXPECT_EQ(report.empty_lines, 2u);
  EXPECT_EQ(report.duplicate_lines, 2u);
}

TEST(RepairMeshTest, RoundingsFarFromTheOriginAreMerged) {
  RawMesh mesh = UnitBox();
  int i = 0;
  for (Vector3d& point : mesh.points) {
    // Some corners are one rounding of single precision away: 6e-5.
    const float x = static_cast<float>(point.x() + 1000.0);
    point.x() = ++i % 3 == 0 ? std::nextafter(x, 2000.0f) : x;
  }
  const RepairReport report = RepairMesh(mesh);
  EXPECT_THAT(mesh.points, SizeIs(8));
  EXPECT_TRUE(report.is_closed);
}

TEST(RepairMeshTest, SoupOfShuffledTurnedRepeatedAndSplitTrianglesIsTheBox) {
  std::mt19937 random(2);
  for (int trial = 0; trial < 20; ++trial) {
    RawMesh mesh;
    AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
    mesh.triangles.resize(8);
    AddPlate(Vector3d::UnitZ(), Vector3d::UnitX(), Vector3d::UnitY(), mesh, 3, 2);
    AddPlate(Vector3d::Zero(), Vector3d::UnitY(), Vector3d::UnitX(), mesh, 2, 5);
    const size_t count = mesh.triangles.size();
    std::swap(mesh.triangles[trial][0], mesh.triangles[trial][1]);
    for (int copies = 0; copies < 3; ++copies) mesh.triangles.push_back(mesh.triangles[random() % count]);
    std::shuffle(mesh.triangles.begin(), mesh.triangles.end(), random);
    for (auto& triangle : mesh.triangles)
      std::rotate(triangle.begin(), triangle.begin() + random() % 3, triangle.end());
    const RepairReport report = RepairMesh(mesh);
    EXPECT_EQ(IrregularEdges(mesh), 0u);
    EXPECT_TRUE(report.is_closed && report.is_oriented && report.is_complete);
    EXPECT_EQ(report.shells, 1u);
    EXPECT_NEAR(EnclosedVolume(mesh), 1.0, 1e-9);
    EXPECT_NEAR(SurfaceArea(mesh), 6.0, 1e-9);
  }
}

TEST(RepairMeshTest, EachClosedShellIsOutward) {
  // A box inside another, one far away, and one that touches this in an edge; all but the first are inside out.
  RawMesh mesh;
  AddBox(Vector3d::Zero(), 4.0 * Vector3d::Ones(), mesh);
  AddBox(Vector3d::Ones(), Vector3d::Ones(), mesh);
  AddBox({9, 0, 0}, Vector3d::Ones(), mesh);
  AddBox({10, 1, 0}, Vector3d::Ones(), mesh);
  for (size_t t = 12; t < mesh.triangles.size(); ++t) std::swap(mesh.triangles[t][0], mesh.triangles[t][1]);
  RawMesh oriented = mesh;
  MergePoints(1e-6, oriented);
  const Orientation orientation = OrientTriangles(oriented);
  EXPECT_EQ(orientation.turned, 36u);
  EXPECT_EQ(orientation.shells, 4u);
  EXPECT_NEAR(EnclosedVolume(oriented), 67.0, 1e-9);
  const RepairReport report = RepairMesh(mesh);
  EXPECT_EQ(report.turned_triangles, 36u);
  EXPECT_EQ(report.shells, 3u);
  EXPECT_TRUE(report.is_closed);
  EXPECT_NEAR(EnclosedVolume(mesh), 66.0, 1e-9) << "without the box inside the other";
  EXPECT_THAT(NoticesOf(report),
              ElementsAre(HasSubstr("1 surface with 12 triangles dropped: inside a closed surface"),
                          "36 triangles turned: the winding differed from that of the neighbours or was inward"));
}

TEST(RepairMeshTest, TheMainOpenSurfaceIsTurnedOutward) {
  RawMesh box = UnitBox();
  box.triangles.resize(10);  // without the top
  RawMesh reversed = box;
  for (auto& triangle : reversed.triangles) std::swap(triangle[1], triangle[2]);
  EXPECT_EQ(RepairMesh(reversed).turned_triangles, 10u);
  EXPECT_EQ(RepairMesh(box).turned_triangles, 0u);
  // A box with a hole; the edges of the wall of the hole are not joined with those of the box.
  RawMesh with_hole = UnitBox();
  const size_t triangles = with_hole.triangles.size();
  AddBox({0.4, 0.4, 0.0}, {0.2, 0.2, 1.0}, with_hole);
  with_hole.triangles.resize(triangles + 8);
  for (size_t t = triangles; t < with_hole.triangles.size(); ++t) {
    std::swap(with_hole.triangles[t][1], with_hole.triangles[t][2]);
  }
  EXPECT_EQ(RepairMesh(with_hole).turned_triangles, 0u);
}

TEST(RepairMeshTest, OpenAndOneSidedSurfacesAreReported) {
  RawMesh open = UnitBox();
  open.triangles.pop_back();
  EXPECT_FALSE(RepairMesh(open).is_closed);
  RawMesh strip;  // of three parts, the last of which is joined to the first upside down
  strip.points = {{0, 0, 0}, {0, 0, 1}, {1, 0, 0}, {1, 0.2, 1}, {0.5, 1, 0.2}, {0.5, 1, 1.2}};
  strip.triangles = {{0, 2, 3}, {0, 3, 1}, {2, 4, 5}, {2, 5, 3}, {4, 1, 0}, {4, 0, 5}};
  const auto triangles = strip.triangles;
  const RepairReport report = RepairMesh(strip);
  EXPECT_FALSE(report.is_oriented);
  EXPECT_EQ(strip.triangles, triangles);
  EXPECT_THAT(NoticesOf(report), ElementsAre(HasSubstr("Moebius strip")));
}

// Programs derive the normals, the winding and whether a shape is convex from the same side of a face.
TEST(RepairMeshTest, FacesThatAreTurnedInsideOutGetOutwardNormals) {
  RawMesh mesh = UnitBox();
  for (size_t side = 0; side < 6; ++side) {
    SurfaceRegion& region = mesh.exact_surface.regions.emplace_back();
    const double sign = side % 2 == 0 ? 1.0 : -1.0;  // the planes 0 and 1 and the cylinders 2 and 3 are turned
    region.shape = std::array{RegionShape::kPlane, RegionShape::kCylinder, RegionShape::kFree}[side / 2];
    region.axis = sign * Vector3d::Unit(static_cast<Eigen::Index>(side / 2));
    region.is_convex = side < 2;
    for (size_t t = 2 * side; t < 2 * side + 2; ++t) {
      if (side < 4) std::swap(mesh.triangles[t][1], mesh.triangles[t][2]);
      const Eigen::Vector3f normal = AreaVector(mesh, mesh.triangles[t]).normalized().cast<float>();
      mesh.exact_surface.region_of.push_back(static_cast<uint32_t>(side));
      mesh.exact_surface.normals.push_back({normal, normal, normal});
    }
  }
  EXPECT_EQ(RepairMesh(mesh).turned_triangles, 8u);
  for (size_t t = 0; t < 12; ++t) {
    for (const Eigen::Vector3f& normal : mesh.exact_surface.normals[t]) {
      EXPECT_NEAR(normal.cast<double>().dot(AreaVector(mesh, mesh.triangles[t])), 0.5, 1e-6) << t;
    }
  }
  const std::vector<SurfaceRegion>& regions = mesh.exact_surface.regions;
  EXPECT_EQ(regions[0].axis, -Vector3d::UnitX());
  EXPECT_EQ(regions[1].axis, Vector3d::UnitX());
  EXPECT_TRUE(regions[0].is_convex);
  EXPECT_TRUE(regions[2].is_convex && regions[3].is_convex) << "they were stated as walls of holes";
  EXPECT_EQ(regions[2].axis, Vector3d::UnitY()) << "the sign of an axis of a cylinder has no meaning";
}

TEST(RepairMeshTest, NormalsAndRegionsStayWithTheirTriangles) {
  std::mt19937 random(3);
  RawMesh mesh;
  AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
  AddPlate({0, 0, 1}, Vector3d::UnitX(), Vector3d::UnitY(), mesh, 2, 2);            // instead of the last side
  AddPlate({0.2, 0.2, 0}, 0.5 * Vector3d::UnitY(), 0.5 * Vector3d::UnitX(), mesh);  // a label
  mesh.triangles.erase(mesh.triangles.begin() + 10, mesh.triangles.begin() + 12);
  mesh.exact_surface.regions.resize(6);
  for (auto& triangle : mesh.triangles) {
    const Vector3d normal = AreaVector(mesh, triangle).normalized();
    Eigen::Index axis;
    normal.cwiseAbs().maxCoeff(&axis);
    mesh.exact_surface.region_of.push_back(static_cast<uint32_t>(2 * axis + (normal[axis] > 0.0 ? 1 : 0)));
    const Eigen::Vector3f stated = normal.cast<float>();
    mesh.exact_surface.normals.push_back({stated, stated, stated});
    mesh.corner_normals.push_back({stated, -stated, Eigen::Vector3f(1, 1, 1).normalized()});
    if (random() % 4 == 0) std::swap(triangle[1], triangle[2]);
  }
  mesh.triangles.push_back(mesh.triangles[3]);
  mesh.corner_normals.push_back(mesh.corner_normals[3]);
  mesh.exact_surface.region_of.push_back(mesh.exact_surface.region_of[3]);
  mesh.exact_surface.normals.push_back(mesh.exact_surface.normals[3]);
  const RepairReport report = RepairMesh(mesh);
  EXPECT_GT(report.turned_triangles, 0u);
  EXPECT_EQ(report.split_edges, 4u);
  EXPECT_EQ(report.duplicate_triangles + report.overlapping_triangles, 3u);
  ASSERT_THAT(mesh.exact_surface.region_of, SizeIs(mesh.triangles.size()));
  ASSERT_THAT(mesh.exact_surface.normals, SizeIs(mesh.triangles.size()));
  ASSERT_THAT(mesh.corner_normals, SizeIs(mesh.triangles.size()));
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Vector3d normal = AreaVector(mesh, mesh.triangles[t]).normalized();
    const uint32_t region = mesh.exact_surface.region_of[t];
    EXPECT_NEAR(normal.dot((region % 2 == 0 ? -1.0 : 1.0) * Vector3d::Unit(region / 2)), 1.0, 1e-6);
    for (const Eigen::Vector3f& exact : mesh.exact_surface.normals[t]) {
      EXPECT_NEAR(exact.cast<double>().dot(normal), 1.0, 1e-6);
    }
    // The last normal is 54.7 degrees from that of the side, as a mean over three sides: none.
    size_t stated = 0;
    for (const Eigen::Vector3f& corner : mesh.corner_normals[t]) {
      stated += corner.cast<double>().dot(normal) > 0.9;
      EXPECT_TRUE(corner.isZero(0.0f) || corner.cast<double>().dot(normal) > 0.7);
    }
    EXPECT_GE(stated, 1u);
  }
}

TEST(RepairMeshTest, EmptyMeshAndLinesAlone) {
  RawMesh empty;
  EXPECT_TRUE(RepairMesh(empty).is_complete);
  RawMesh lines;
  lines.points = {{0, 0, 0}, {1, 0, 0}, {1, 0, 0}};
  lines.lines = {{0, 1}, {2, 0}, {1, 2}};
  const RepairReport report = RepairMesh(lines);
  EXPECT_THAT(lines.lines, SizeIs(1));
  EXPECT_THAT(NoticesOf(report), ElementsAre("1 line of length zero dropped", "1 duplicate line dropped"));
}

TEST(RepairMeshTest, CadFiles) {
  const auto repair = [](const std::string& name, double metres_per_unit, RawMesh& mesh) {
    std::ifstream file(FindTestData("cad/" + name), std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(file), {}};
    absl::StatusOr<RawMesh> read =
        ReadStl({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}, {.max_triangles = 1'000'000});
    EXPECT_TRUE(read.ok()) << read.status();
    if (read.ok()) mesh = *std::move(read);
    for (Vector3d& point : mesh.points) point *= metres_per_unit;
    return RepairMesh(mesh);
  };
  // The same block as it was exported, with jitter, with triangles turned, and in another unit.
  RawMesh block;
  const RepairReport expected = repair("angle_block.STL", 0.0254, block);
  EXPECT_TRUE(expected.is_closed && expected.is_oriented && expected.is_complete);
  for (const char* name : {"x_jitter.stl", "x_flip.stl", "x_tiny.stl"}) {
    RawMesh mesh;
    const RepairReport report = repair(name, 0.0254, mesh);
    EXPECT_THAT(mesh.points, SizeIs(block.points.size())) << name;
    EXPECT_THAT(mesh.triangles, SizeIs(block.triangles.size())) << name;
    EXPECT_TRUE(report.is_closed && report.is_oriented && report.is_complete) << name;
    EXPECT_GT(EnclosedVolume(mesh), 0.0) << name;
  }
}

// The two sides differ after the repair of junctions: here, one of a narrow triangle without a counterpart is dropped.
TEST(RepairMeshTest, ABodyWithTwoSidesEverywhereKeepsOneSide) {
  RawMesh mesh = UnitBox();
  const size_t triangles = mesh.triangles.size();
  for (size_t t = 0; t < triangles; ++t) {
    const auto [i, j, k] = mesh.triangles[t];
    AddTriangle(Vector3d(mesh.points[i]), Vector3d(mesh.points[k]), Vector3d(mesh.points[j]), mesh);
  }
  AddTriangle({0.2, 0.0, 1.0}, {0.8, 0.0, 1.0}, {0.5, 2e-5, 1.0}, mesh);
  const RepairReport report = RepairMesh(mesh);
  EXPECT_EQ(report.duplicate_triangles, triangles);
  EXPECT_NEAR(EnclosedVolume(mesh), 1.0, 1e-9);
  EXPECT_NEAR(SurfaceArea(mesh), 6.0, 1e-3);
  EXPECT_TRUE(report.is_oriented);
}

TEST(DropUnusedPointsTest, PointsOfTrianglesLinesAndExactEdgesStay) {
  RawMesh mesh;
  for (int i = 0; i < 9; ++i) mesh.points.emplace_back(i, 0.0, 0.0);
  mesh.triangles = {{1, 2, 4}};
  mesh.lines = {{4, 6}};
  mesh.exact_edges.resize(1);
  mesh.exact_edges[0].points = {7, 1};
  EXPECT_EQ(DropUnusedPoints(mesh), 4u);
  ASSERT_EQ(mesh.points.size(), 5u);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(mesh.points[i].x(), (std::array{1, 2, 4, 6, 7})[i]);
  EXPECT_EQ(mesh.triangles[0], (std::array<uint32_t, 3>{0, 1, 2}));
  EXPECT_EQ(mesh.lines[0], (std::array<uint32_t, 2>{2, 3}));
  EXPECT_EQ(mesh.exact_edges[0].points, (std::vector<uint32_t>{4, 0}));
  EXPECT_EQ(DropUnusedPoints(mesh), 0u);
}

TEST(DescribeRepairTest, EachRepairIsReported) {
  RepairReport report;
  report.merged_points = 1;
  report.split_edges = 2;
  report.degenerate_triangles = 3;
  report.duplicate_triangles = 4;
  report.overlapping_triangles = 5;
  report.is_complete = false;
  EXPECT_THAT(NoticesOf(report),
              ElementsAre("1 point merged with others within the tolerance", "3 triangles without area dropped",
                          "4 duplicate triangles dropped", "2 edges split at vertices of other triangles",
                          HasSubstr("5 overlapping triangles dropped"), HasSubstr("more faults than are repaired")));
}

TEST(NoteImplausibleSizeTest, NamesTheSizeAndTheProbableScale) {
  const auto notices = [](double side, double metres_per_unit) {
    RawMesh mesh;
    AddBox(Vector3d::Zero(), side * metres_per_unit * Vector3d(1.0, 0.5, 0.5), mesh);
    std::vector<std::string> result;
    NoteImplausibleSize(mesh, metres_per_unit, result);
    return result;
  };
  EXPECT_THAT(notices(123.4, 1.0),
              ElementsAre("largest side 123.4 units: taken as metres; if these are millimetres pass --scale 0.001"));
  EXPECT_THAT(notices(0.25, 0.001),
              ElementsAre("largest side 0.25 units: taken as millimetres; if these are metres pass --scale 1"));
  EXPECT_THAT(notices(2e4, 1.0),
              ElementsAre("largest side 20000 units: taken as metres; if these are micrometres pass --scale 1e-06"));
  EXPECT_THAT(notices(0.001, 1.0), ElementsAre("largest side 0.001 units: taken as metres, which is unusually small; "
                                               "check the unit of the file, and pass its metres as --scale"));
  EXPECT_THAT(notices(2.0, 7.0),
              ElementsAre("largest side 2 units: taken as 14 m; if these are metres pass --scale 1"));
  EXPECT_THAT(notices(0.006, 1.0), IsEmpty());
  EXPECT_THAT(notices(4.0, 1.0), IsEmpty());
  EXPECT_THAT(notices(123.4, 0.001), IsEmpty());
}

TEST(FindSurfaceTest, AFaceKeepsItsNormalAtTheBorderToAFillet) {
  // A wide strip, a fillet of four narrow ones that turn by 15 degrees each, and another wide strip.
  RawMesh mesh;
  std::vector<Eigen::Vector2d> profile = {{-1.0, 0.0}, {0.0, 0.0}};
  for (int i = 1; i <= 4; ++i) {
    const double angle = (15.0 * i) * std::numbers::pi / 180.0;
    profile.push_back(profile.back() + 0.02 * Eigen::Vector2d(std::cos(angle), -std::sin(angle)));
  }
  profile.push_back(profile.back() +
                    Eigen::Vector2d(std::cos(75 * std::numbers::pi / 180), -std::sin(75 * std::numbers::pi / 180)));
  for (const Eigen::Vector2d& p : profile) {
    mesh.points.push_back({p.x(), 0.0, p.y()});
    mesh.points.push_back({p.x(), 1.0, p.y()});
  }
  for (uint32_t i = 0; i + 3 < mesh.points.size(); i += 2) {
    mesh.triangles.push_back({i, i + 2, i + 3});
    mesh.triangles.push_back({i, i + 3, i + 1});
  }
  const SurfaceEdges found = FindSurface(mesh, {}, 2.0);
  const Eigen::Vector3f& at_border = found.surface.normals[0][1];
  EXPECT_GT(at_border.z(), std::cos(1.0 * std::numbers::pi / 180.0)) << at_border.transpose();
}

}  // namespace
}  // namespace evpose
