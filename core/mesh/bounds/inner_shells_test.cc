// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/inner_shells.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "core/mesh/mesh_repair.h"
#include "core/mesh/mesh_topology.h"
#include "core/mesh/meshes_testing.h"

namespace evpose {
namespace {

using Eigen::Vector3d;
using ::testing::Contains;

RawMesh Housing() {
  RawMesh mesh;
  AddBox(Vector3d::Zero(), {10, 8, 6}, mesh);
  return mesh;
}

void TurnTriangles(size_t first, RawMesh& mesh) {
  for (size_t t = first; t < mesh.triangles.size(); ++t) std::swap(mesh.triangles[t][1], mesh.triangles[t][2]);
}

// A tetrahedron with the corner of a cube and its three neighbours.
void AddCorner(double size, RawMesh& mesh) {
  const Vector3d o = Vector3d::Zero(), x(size, 0, 0), y(0, size, 0), z(0, 0, size);
  AddTriangle(o, y, x, mesh);
  AddTriangle(o, x, z, mesh);
  AddTriangle(o, z, y, mesh);
  AddTriangle(x, y, z, mesh);
}

TEST(InnerShellsTest, ShellsInsideAClosedOneAreDroppedWhateverTheirWinding) {
  for (const bool is_cavity : {false, true}) {
    RawMesh mesh = Housing();
    AddBox({1, 1, 1}, {8, 6, 4}, mesh);
    if (is_cavity) TurnTriangles(12, mesh);
    AddBox({2, 2, 2}, {1, 1, 1}, mesh);                               // in the inner one
    AddPlate({5, 5, 2}, Vector3d::UnitX(), Vector3d::UnitY(), mesh);  // open
    const RepairReport report = RepairMesh(mesh);
    EXPECT_EQ(report.inner_shells, 3u);
    EXPECT_EQ(report.inner_triangles, 26u);
    EXPECT_EQ(report.shells, 1u);
    EXPECT_EQ(mesh.triangles.size(), 12u);
    EXPECT_NEAR(EnclosedVolume(mesh), 480.0, 1e-9);
    std::vector<std::string> notices;
    DescribeRepair(report, notices);
    EXPECT_THAT(notices, Contains("3 surfaces with 26 triangles dropped: inside a closed surface, where no camera sees "
                                  "them"));
  }
}

TEST(InnerShellsTest, ShellsThatCanBeSeenStay) {
  struct Part {
    const char* name;
    Vector3d corner, size;
  };
  for (const Part& part :
       {Part{"outside", {12, 1, 1}, {1, 1, 1}}, Part{"through the wall", {9, 1, 1}, {2, 1, 1}},
        Part{"flush with the wall", {1, 1, 5}, {1, 1, 1}}, Part{"through both walls", {-1, 3, 3}, {12, 1, 1}}}) {
    RawMesh mesh = Housing();
    AddBox(part.corner, part.size, mesh);
    const RepairReport report = RepairMesh(mesh);
    EXPECT_EQ(report.inner_shells, 0u) << part.name;
    EXPECT_GE(mesh.triangles.size(), 20u) << part.name;
  }
  RawMesh open = Housing();
  open.triangles.resize(10);
  AddBox({2, 2, 2}, {1, 1, 1}, open);
  EXPECT_EQ(RepairMesh(open).inner_shells, 0u) << "the housing is open";
}

TEST(InnerShellsTest, TheBoxOfAShellDoesNotDecide) {
  for (const auto& [place, is_inside] : {std::pair(1.0, true), std::pair(5.0, false)}) {
    RawMesh mesh;
    AddCorner(10.0, mesh);
    AddBox({place, place, place}, {1, 1, 1}, mesh);
    EXPECT_EQ(RepairMesh(mesh).inner_shells, is_inside ? 1u : 0u) << place;
  }
}

TEST(InnerShellsTest, PointsThatAreAlignedWithEdgesOfTheHousingAreInside) {
  // The centroids of the triangles of the inner plates lie on lines through vertices and along edges of the housing.
  RawMesh mesh;
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3d u = 3.0 * Vector3d::Unit((axis + 1) % 3), v = 3.0 * Vector3d::Unit((axis + 2) % 3);
    AddPlate(Vector3d::Zero(), v, u, mesh, 3, 3);
    AddPlate(3.0 * Vector3d::Unit(axis), u, v, mesh, 3, 3, true);
  }
  const size_t housing = mesh.triangles.size();
  AddTriangle({1.0, 0.5, 0.5}, {2.0, 1.5, 0.5}, {1.5, 1.0, 2.0}, mesh);  // its centroid is (1.5, 1, 1)
  AddTriangle({1.0, 1.5, 1.0}, {2.0, 1.5, 1.0}, {1.5, 1.5, 2.5}, mesh);  // (1.5, 1.5, 1.5), on diagonals
  const RepairReport report = RepairMesh(mesh);
  EXPECT_EQ(report.inner_shells, 2u);
  EXPECT_EQ(mesh.triangles.size(), housing);
}

TEST(InnerShellsTest, AShellWithinTheToleranceOfTheHousingStays) {
  for (const double gap : {0.001, 0.1}) {
    RawMesh mesh = Housing();
    AddBox({1, 1, 5.0 - gap}, {1, 1, 1}, mesh);
    const std::vector<uint32_t> shells = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
    RawMesh welded = mesh;
    MergePoints(1e-9, welded);
    EXPECT_EQ(RemoveInnerShells(0.01, shells, 2, welded).shells, gap > 0.01 ? 1u : 0u) << gap;
  }
  RawMesh single = Housing();
  EXPECT_EQ(RemoveInnerShells(0.01, std::vector<uint32_t>(12, 0), 1, single).shells, 0u);
}

}  // namespace
}  // namespace evpose
