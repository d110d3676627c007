// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_junctions.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "core/mesh/box_tree.h"
#include "core/mesh/mesh_topology.h"
#include "core/mesh/meshes_testing.h"

namespace evpose {
namespace {

using Eigen::Vector3d;
using ::testing::ElementsAre;
using ::testing::SizeIs;
using Corners = std::array<uint32_t, 3>;

constexpr double kToleranceM = 1e-5;

// A box whose top has more parts than its walls.
RawMesh BoxWithFineTop(int parts) {
  RawMesh mesh;
  AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
  mesh.triangles.resize(10);
  AddPlate(Vector3d::UnitZ(), Vector3d::UnitX(), Vector3d::UnitY(), mesh, parts, parts);
  MergePoints(kToleranceM, mesh);
  return mesh;
}

TEST(CloseJunctionsTest, MeshWithoutJunctionsStaysAsItIs) {
  RawMesh mesh = BoxWithFineTop(1);
  const RawMesh before = mesh;
  const JunctionReport report = CloseJunctions(kToleranceM, mesh);
  EXPECT_EQ(mesh.triangles, before.triangles);
  EXPECT_EQ(mesh.points, before.points);
  EXPECT_EQ(report.split_edges + report.degenerate_triangles + report.duplicate_triangles, 0u);
  EXPECT_TRUE(report.is_complete);
}

TEST(CloseJunctionsTest, WallsAreSplitAtTheVerticesOfTheTop) {
  for (const int parts : {2, 3, 7}) {
    RawMesh mesh = BoxWithFineTop(parts);
    ASSERT_GT(IrregularEdges(mesh), 0u);
    const JunctionReport report = CloseJunctions(kToleranceM, mesh);
    EXPECT_EQ(report.split_edges, 4u);
    EXPECT_TRUE(report.is_complete);
    EXPECT_EQ(IrregularEdges(mesh), 0u);
    EXPECT_THAT(mesh.triangles, SizeIs(10 + 2 * parts * parts + 4 * (parts - 1)));
    EXPECT_NEAR(EnclosedVolume(mesh), 1.0, 1e-12);
    EXPECT_NEAR(SurfaceArea(mesh), 6.0, 1e-12);
  }
}

TEST(CloseJunctionsTest, AllSidesOfOneTriangleAreSplit) {
  // A triangle inside three others that have one or two vertices on each of its sides.
  RawMesh mesh;
  const Vector3d a(0, 0, 0), b(3, 0, 0), c(0, 3, 0);
  AddTriangle(a, b, c, mesh);
  AddTriangle(a, {1, -1, 0}, {1, 0, 0}, mesh);
  AddTriangle({1, 0, 0}, {2, -1, 0}, {2, 0, 0}, mesh);
  AddTriangle({2, 0, 0}, {3, -1, 0}, b, mesh);
  AddTriangle({1.5, 1.5, 0}, {3, 3, 0}, c, mesh);
  AddTriangle({0, 1, 0}, {-1, 1, 0}, a, mesh);
  MergePoints(kToleranceM, mesh);
  const double area = SurfaceArea(mesh);
  const JunctionReport report = CloseJunctions(kToleranceM, mesh);
  EXPECT_EQ(report.split_edges, 3u);
  EXPECT_THAT(mesh.triangles, SizeIs(5 + 1 + 4));
  EXPECT_NEAR(SurfaceArea(mesh), area, 1e-12);
  for (const auto& triangle : mesh.triangles) EXPECT_GT(AreaVector(mesh, triangle).z(), 0.0);
}

TEST(CloseJunctionsTest, FlatTriangleLeavesNoHole) {
  // A tetrahedron in whose edge 0-1 a flat triangle with the vertex 4 fills the gap between one face and two.
  for (const double height_m : {0.0, 0.5 * kToleranceM, -0.9 * kToleranceM}) {
    RawMesh mesh;
    mesh.points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0.3, height_m, 0}};
    mesh.triangles = {{0, 4, 1}, {0, 2, 4}, {4, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    ASSERT_EQ(IrregularEdges(mesh), 0u);
    const JunctionReport report = CloseJunctions(kToleranceM, mesh);
    EXPECT_EQ(report.degenerate_triangles, 1u);
    EXPECT_THAT(mesh.triangles, ElementsAre(Corners{0, 2, 4}, Corners{4, 2, 1}, Corners{0, 4, 3}, Corners{4, 1, 3},
                                            Corners{0, 3, 2}, Corners{1, 2, 3}));
    EXPECT_EQ(IrregularEdges(mesh), 0u);
  }
}

TEST(CloseJunctionsTest, FlatTrianglesThatShareLongSidesLeaveNoHole) {
  // Between the triangle below and the strip above are flat triangles, each on a side of the one before.
  RawMesh mesh;
  const double h = 0.1 * kToleranceM;
  mesh.points = {{0, 0, 0}, {8, 0, 0}, {4, h, 0}, {2, 2 * h, 0}, {6, 2 * h, 0}, {4, -4, 0}, {4, 4, 0}};
  mesh.triangles = {{5, 1, 0}, {0, 1, 2}, {0, 2, 3}, {2, 1, 4}, {0, 3, 6}, {3, 2, 6}, {2, 4, 6}, {4, 1, 6}};
  ASSERT_EQ(IrregularEdges(mesh), 4u);  // the outline
  const JunctionReport report = CloseJunctions(kToleranceM, mesh);
  EXPECT_EQ(report.degenerate_triangles, 3u);
  EXPECT_TRUE(report.is_complete);
  EXPECT_EQ(IrregularEdges(mesh), 4u);
  EXPECT_THAT(mesh.triangles, SizeIs(8));
  EXPECT_NEAR(SurfaceArea(mesh), 32.0, 1e-3);
}

// A prism on a segment of a circle, whose lids are triangulated as ear clipping does: each round cuts off every other
// vertex of the arc.
RawMesh ArcPrism(double angle_rad, int chords) {
  RawMesh mesh;
  std::vector<Vector3d> arc;
  for (int i = 0; i <= chords; ++i) {
    const double angle = angle_rad * (static_cast<double>(i) / chords - 0.5);
    arc.emplace_back(std::sin(angle), std::cos(angle), 0.0);
  }
  const Vector3d centre(0.0, -1.0, 0.0), up(0.0, 0.0, 0.1);
  const auto add_lids = [&](const Vector3d& a, const Vector3d& b, const Vector3d& c) {
    AddTriangle(a + up, b + up, c + up, mesh);
    AddTriangle(a, c, b, mesh);
  };
  std::vector<Vector3d> rest = arc;
  while (rest.size() > 2) {
    std::vector<Vector3d> next;
    for (size_t i = 0; i < rest.size(); ++i) {
      if (i % 2 == 0 || i + 1 == rest.size()) {
        next.push_back(rest[i]);
      } else {
        add_lids(rest[i + 1], rest[i], rest[i - 1]);
      }
    }
    rest = std::move(next);
  }
  add_lids(rest[1], rest[0], centre);
  arc.push_back(centre);
  for (size_t i = 0; i < arc.size(); ++i) {
    const Vector3d &a = arc[i], &b = arc[(i + 1) % arc.size()];
    AddTriangle(a, b + up, b, mesh);
    AddTriangle(a, a + up, b + up, mesh);
  }
  MergePoints(kToleranceM, mesh);
  return mesh;
}

TEST(BoxTreeTest, NoSearchThatMeetsABoxVisitsFewerNodesThanTheBound) {
  std::mt19937 random(1);
  for (const size_t count : {1, 4, 5, 9, 100, 1000, 1023}) {
    std::vector<Eigen::AlignedBox3f> boxes;
    for (size_t i = 0; i < count; ++i) {
      const Eigen::Vector3f at(static_cast<float>(random() % 1000), static_cast<float>(random() % 1000), 0.0f);
      boxes.emplace_back(at, at + Eigen::Vector3f::Ones());
    }
    const BoxTree tree(boxes);
    size_t least = 1000;
    for (const Eigen::AlignedBox3f& box : boxes) {
      size_t budget = 1000;
      ASSERT_TRUE(tree.VisitMeeting(box, budget, [](uint32_t) {}));
      least = std::min(least, 1000 - budget);
    }
    EXPECT_GE(least, BoxTree::LeastNodes(count)) << count;
    EXPECT_LE(least, BoxTree::LeastNodes(count) + 4) << "the bound is close";
  }
  EXPECT_EQ(BoxTree::LeastNodes(0), 0u);
}

TEST(CloseJunctionsTest, FlatTrianglesOfAnArcEndWithoutAHole) {
  // Arcs whose smallest, or larger and larger, ears are flat.
  for (const double step_rad : {0.0025, 0.003, 0.004, 0.0045, 0.006}) {
    for (const int chords : {3, 4, 5, 8, 11, 30, 64}) {
      RawMesh mesh = ArcPrism(step_rad * chords, chords);
      ASSERT_EQ(IrregularEdges(mesh), 0u);
      const double volume = EnclosedVolume(mesh);
      const JunctionReport report = CloseJunctions(kToleranceM, mesh);
      EXPECT_TRUE(report.is_complete) << step_rad << ' ' << chords;
      EXPECT_EQ(IrregularEdges(mesh), 0u) << step_rad << ' ' << chords;
      EXPECT_NEAR(EnclosedVolume(mesh), volume, 1e-12);
      if (step_rad < 0.004 && chords < 5) {
        EXPECT_GT(report.degenerate_triangles, 0u) << step_rad << ' ' << chords;
      }
    }
  }
}

TEST(CloseJunctionsTest, NormalsAndRegionsOfPartsAreThoseOfTheTriangle) {
  RawMesh mesh;
  AddTriangle({0, 0, 0}, {4, 0, 0}, {0, 4, 0}, mesh);
  AddTriangle({0, 0, 0}, {0, -4, 0}, {1, 0, 0}, mesh);
  MergePoints(kToleranceM, mesh);
  const Eigen::Vector3f along_x(1, 0, 0), along_y(0, 1, 0), along_z(0, 0, 1);
  mesh.corner_normals = {{along_x, along_y, along_z}, {along_z, along_z, along_z}};
  mesh.exact_surface.regions.resize(2);
  mesh.exact_surface.region_of = {1, 0};
  mesh.exact_surface.normals = {{along_z, Eigen::Vector3f::Zero(), along_y}, {along_z, along_z, along_z}};
  CloseJunctions(kToleranceM, mesh);
  ASSERT_THAT(mesh.triangles, ElementsAre(Corners{0, 4, 2}, Corners{4, 1, 2}, Corners{0, 3, 4}));
  EXPECT_THAT(mesh.exact_surface.region_of, ElementsAre(1, 1, 0));
  ASSERT_THAT(mesh.corner_normals, SizeIs(3));
  ASSERT_THAT(mesh.exact_surface.normals, SizeIs(3));
  // A quarter of the way from x to y.
  const Eigen::Vector3f between = Eigen::Vector3f(3, 1, 0).normalized();
  EXPECT_TRUE(mesh.corner_normals[0][0] == along_x && mesh.corner_normals[0][2] == along_z);
  EXPECT_TRUE(mesh.corner_normals[0][1].isApprox(between) && mesh.corner_normals[1][0].isApprox(between));
  EXPECT_TRUE(mesh.corner_normals[1][1] == along_y && mesh.corner_normals[1][2] == along_z);
  EXPECT_TRUE(mesh.exact_surface.normals[0][1].isZero());  // the normal at one of the ends is missing
}

TEST(CloseJunctionsTest, WorkOnCoincidingEdgesIsBounded) {
  // Triangles whose sides lie on one line and end in different places: each side contains the ends of most others.
  RawMesh mesh;
  constexpr int kTriangles = 2000;
  for (int i = 0; i < kTriangles; ++i) {
    AddTriangle({-1.0 - i, 0, 0}, {1.0 + i, 0, 0}, {0, std::sin(i), std::cos(i)}, mesh);
  }
  const JunctionReport report = CloseJunctions(kToleranceM, mesh);
  EXPECT_FALSE(report.is_complete);
  EXPECT_LE(mesh.triangles.size(), 5u * kTriangles);
}

}  // namespace
}  // namespace evpose
