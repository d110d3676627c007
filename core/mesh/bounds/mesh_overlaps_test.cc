// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_overlaps.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/mesh/mesh_topology.h"
#include "core/mesh/meshes_testing.h"

namespace evpose {
namespace {

using Eigen::Vector3d;
using ::testing::ElementsAre;
using ::testing::SizeIs;

constexpr double kOverlapToleranceM = 1e-5;

OverlapReport MergeAndRemoveOverlaps(RawMesh& mesh) {
  MergePoints(kOverlapToleranceM, mesh);
  return RemoveOverlaps(kOverlapToleranceM, OrientTriangles(mesh).shell_of, mesh);
}

// Appends the triangles of the mesh once more, with the other winding and points of their own.
void AddSecondSides(RawMesh& mesh) {
  const std::vector<std::array<uint32_t, 3>> first_sides = mesh.triangles;
  for (const auto& [i, j, k] : first_sides) {
    AddTriangle(Vector3d(mesh.points[i]), Vector3d(mesh.points[k]), Vector3d(mesh.points[j]), mesh);
  }
}

size_t MergeAndRemoveSecondSides(RawMesh& mesh) {
  MergePoints(kOverlapToleranceM, mesh);
  return RemoveSecondSides(mesh);
}

TEST(RemoveSecondSidesTest, ABodyWithTwoSidesEverywhereKeepsOne) {
  RawMesh mesh;
  AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
  AddBox({2, 0, 0}, Vector3d::Ones(), mesh);
  AddSecondSides(mesh);
  EXPECT_EQ(MergeAndRemoveSecondSides(mesh), 24u);
  EXPECT_EQ(IrregularEdges(mesh), 0u);
  EXPECT_EQ(OrientTriangles(mesh).shells, 2u);
  EXPECT_NEAR(EnclosedVolume(mesh), 2.0, 1e-12);
}

TEST(RemoveSecondSidesTest, ASmallOpeningDoesNotMakeABodyASheet) {
  for (const int parts : {4, 1}) {
    RawMesh mesh;
    for (int axis = 0; axis < 3; ++axis) {
      const Vector3d u = Vector3d::Unit((axis + 1) % 3), v = Vector3d::Unit((axis + 2) % 3);
      AddPlate(Vector3d::Zero(), v, u, mesh, parts, parts);
      AddPlate(Vector3d::Unit(axis), u, v, mesh, parts, parts);
    }
    mesh.triangles.resize(mesh.triangles.size() - 2);  // an opening of 1 / 16 or all of a side
    const size_t triangles = mesh.triangles.size();
    AddSecondSides(mesh);
    EXPECT_EQ(MergeAndRemoveSecondSides(mesh), parts == 4 ? triangles : 0u);
  }
}

TEST(RemoveSecondSidesTest, SheetsAndWallsBetweenBodiesAreKept) {
  RawMesh sheet;
  AddPlate(Vector3d::Zero(), Vector3d::UnitX(), Vector3d::UnitY(), sheet, 3, 2);
  AddSecondSides(sheet);
  EXPECT_EQ(MergeAndRemoveSecondSides(sheet), 0u);
  RawMesh boxes;
  AddBox(Vector3d::Zero(), Vector3d::Ones(), boxes);
  AddBox(Vector3d::UnitX(), Vector3d::Ones(), boxes);
  EXPECT_EQ(MergeAndRemoveSecondSides(boxes), 0u);
}

TEST(RemoveOverlapsTest, CopyOfASideWithOtherTrianglesIsRemoved) {
  for (const int parts : {1, 3}) {
    RawMesh mesh;
    AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
    const auto box = mesh.triangles;
    AddPlate(Vector3d::UnitZ(), Vector3d::UnitX(), Vector3d::UnitY(), mesh, parts, parts, /*is_other_diagonal=*/true);
    const OverlapReport report = MergeAndRemoveOverlaps(mesh);
    EXPECT_EQ(report.removed_triangles, 2u * parts * parts);
    EXPECT_TRUE(report.is_complete);
    EXPECT_THAT(mesh.triangles, SizeIs(box.size()));
    EXPECT_EQ(IrregularEdges(mesh), 0u);
  }
}

TEST(RemoveOverlapsTest, CopyOfASheetStaysAsItsOtherSide) {
  RawMesh mesh;
  AddPlate(Vector3d::Zero(), Vector3d::UnitX(), Vector3d::UnitY(), mesh, 5, 4);
  AddPlate(Vector3d::Zero(), Vector3d::UnitX(), Vector3d::UnitY(), mesh, 5, 4, /*is_other_diagonal=*/true);
  EXPECT_EQ(MergeAndRemoveOverlaps(mesh).removed_triangles, 0u);
}

TEST(RemoveOverlapsTest, LabelOnASideIsRemoved) {
  // Across the diagonal of the side, before and behind it in the file, and a little above its plane.
  for (const double height_m : {0.0, 0.5 * kOverlapToleranceM}) {
    for (const bool is_first : {false, true}) {
      RawMesh mesh;
      const auto add_label = [&] {
        AddPlate({0.3, 0.2, 1.0 + height_m}, 0.4 * Vector3d::UnitX(), 0.5 * Vector3d::UnitY(), mesh);
      };
      if (is_first) add_label();
      AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
      if (!is_first) add_label();
      EXPECT_EQ(MergeAndRemoveOverlaps(mesh).removed_triangles, 2u);
      EXPECT_NEAR(SurfaceArea(mesh), 6.0, 1e-9);
    }
  }
}

TEST(RemoveOverlapsTest, PlatesThatOverlapInPartOrTouchAreKept) {
  RawMesh mesh;
  AddPlate(Vector3d::Zero(), Vector3d::UnitX(), Vector3d::UnitY(), mesh);
  AddPlate({0.5, 0.5, 0}, Vector3d::UnitX(), Vector3d::UnitY(), mesh);
  AddPlate({2.0, 0, 0}, Vector3d::UnitX(), Vector3d::UnitY(), mesh);
  AddPlate({2.2, 0.2, 100 * kOverlapToleranceM}, 0.5 * Vector3d::UnitX(), 0.5 * Vector3d::UnitY(), mesh);
  EXPECT_EQ(MergeAndRemoveOverlaps(mesh).removed_triangles, 0u);
  EXPECT_THAT(mesh.triangles, SizeIs(8));
}

TEST(RemoveOverlapsTest, WallBetweenTwoBoxesIsRemoved) {
  for (const bool is_other_diagonal : {false, true}) {
    RawMesh mesh;
    AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
    mesh.triangles.resize(10);
    AddPlate(Vector3d::UnitZ(), Vector3d::UnitX(), Vector3d::UnitY(), mesh, 1, 1, is_other_diagonal);
    AddBox(Vector3d::UnitZ(), {1, 1, 2}, mesh);
    const OverlapReport report = MergeAndRemoveOverlaps(mesh);
    EXPECT_EQ(report.removed_triangles, 4u);
    EXPECT_EQ(IrregularEdges(mesh), 0u);
    EXPECT_NEAR(EnclosedVolume(mesh), 3.0, 1e-12);
    const Orientation orientation = OrientTriangles(mesh);
    EXPECT_EQ(orientation.shells, 1u);
    EXPECT_TRUE(orientation.is_closed);
  }
}

TEST(RemoveOverlapsTest, OneOfTwoCopiesWithOppositeWindingsIsRemoved) {
  RawMesh mesh;
  AddBox(Vector3d::Zero(), Vector3d::Ones(), mesh);
  const auto [i, j, k] = mesh.triangles[4];
  mesh.triangles.push_back({i, k, j});
  AddPlate({0.3, 0.2, 1.0}, 0.4 * Vector3d::UnitY(), 0.5 * Vector3d::UnitX(), mesh);  // a label from its back
  EXPECT_EQ(MergeAndRemoveOverlaps(mesh).removed_triangles, 3u);
  EXPECT_EQ(IrregularEdges(mesh), 0u);
  EXPECT_TRUE(OrientTriangles(mesh).is_closed);
}

TEST(RemoveOverlapsTest, SheetsWithTwoSidesAreKept) {
  // Alone, with different diagonals, as a fin on a box, and as a membrane in an open tube.
  for (const int kind : {0, 1, 2, 3}) {
    RawMesh mesh;
    if (kind == 2) AddBox({0, 0, -1}, Vector3d::Ones(), mesh);
    const Vector3d u = Vector3d::UnitX(), v = kind == 2 ? Vector3d::UnitZ() : Vector3d::UnitY();
    AddPlate(Vector3d::Zero(), u, v, mesh);
    AddPlate(Vector3d::Zero(), v, u, mesh, 1, 1, kind == 1);
    for (int side = 0; side < 4 && kind == 3; ++side) {
      const Vector3d along = side % 2 == 0 ? u : v;
      const Vector3d corner = side < 2 ? Vector3d(Vector3d::Zero()) : Vector3d(side == 2 ? v : u);
      AddPlate(corner, along, Vector3d::UnitZ(), mesh);
      AddPlate(corner, along, -Vector3d::UnitZ(), mesh);
    }
    const size_t count = mesh.triangles.size();
    EXPECT_EQ(MergeAndRemoveOverlaps(mesh).removed_triangles, 0u) << kind;
    EXPECT_THAT(mesh.triangles, SizeIs(count));
  }
}

TEST(RemoveOverlapsTest, BoxesThatStandOnOrReachIntoAnotherStayClosed) {
  // The base of the first lies on the plate, with the opposite winding; that of the second is in the lower plane.
  RawMesh mesh;
  AddBox(Vector3d::Zero(), {4, 4, 1}, mesh);
  AddBox({1, 1, 1}, {1, 1, 1}, mesh);
  AddBox({2.5, 2.5, 0}, {1, 1, 3}, mesh);
  const OverlapReport report = MergeAndRemoveOverlaps(mesh);
  EXPECT_EQ(report.removed_triangles, 0u);
  EXPECT_TRUE(OrientTriangles(mesh).is_closed);
  // The outline of the base of the second is within the face of the plate.
  EXPECT_THAT(report.covered_edges, SizeIs(4));
  for (const auto& [low, high] : report.covered_edges) {
    for (const uint32_t vertex : {low, high}) {
      EXPECT_EQ(mesh.points[vertex].z(), 0.0);
      EXPECT_GE(mesh.points[vertex].head<2>().minCoeff(), 2.5);
      EXPECT_LE(mesh.points[vertex].head<2>().maxCoeff(), 3.5);
    }
  }
}

TEST(RemoveOverlapsTest, OutlinesOfPlatesThatOverlapInPartAreCoveredWhereTheOtherContinues) {
  RawMesh mesh;
  AddPlate(Vector3d::Zero(), {4, 0, 0}, {0, 4, 0}, mesh);
  AddPlate({1, 1, 0}, {2, 0, 0}, {0, 5, 0}, mesh);
  const OverlapReport report = MergeAndRemoveOverlaps(mesh);
  EXPECT_EQ(report.removed_triangles, 0u);
  // The lower side of the second; its other sides and its diagonal extend beyond the first.
  EXPECT_THAT(report.covered_edges, ElementsAre(std::array<uint32_t, 2>{4, 5}));
}

// A closed cylinder. The triangles of each of its two ends share the centre of the end.
void AddDrum(const Vector3d& middle, double radius_m, double height_m, int sides, RawMesh& mesh) {
  const auto rim = [&](int i, double z) -> Vector3d {
    const double turn = 2.0 * std::numbers::pi * (i % sides) / sides;
    return middle + Vector3d(radius_m * std::cos(turn), radius_m * std::sin(turn), z);
  };
  const Vector3d top = middle + height_m * Vector3d::UnitZ();
  for (int i = 0; i < sides; ++i) {
    AddTriangle(middle, rim(i + 1, 0), rim(i, 0), mesh);
    AddTriangle(top, rim(i, height_m), rim(i + 1, height_m), mesh);
    AddTriangle(rim(i, 0), rim(i + 1, 0), rim(i + 1, height_m), mesh);
    AddTriangle(rim(i, 0), rim(i + 1, height_m), rim(i, height_m), mesh);
  }
}

TEST(RemoveOverlapsTest, LidsOfManyNarrowTrianglesThatTouchAreComparedWithinTheLimits) {
  RawMesh mesh;
  constexpr int kSides = 300;
  AddDrum(Vector3d::Zero(), 1.0, 0.2, kSides, mesh);
  AddDrum({0.3, 0.1, 0.2}, 0.5, 0.4, kSides, mesh);
  const double area = SurfaceArea(mesh);
  const OverlapReport report = MergeAndRemoveOverlaps(mesh);
  EXPECT_TRUE(report.is_complete);
  EXPECT_EQ(report.removed_triangles, 0u);
  EXPECT_NEAR(SurfaceArea(mesh), area, 1e-12);
}

TEST(RemoveOverlapsTest, WorkOnManyPlatesInOnePlaceIsBounded) {
  RawMesh mesh;
  constexpr int kPlates = 600;
  for (int i = 0; i < kPlates; ++i) {
    const double offset = 1e-3 * i;
    AddPlate({offset, -offset, 0}, Vector3d::UnitX(), Vector3d::UnitY(), mesh);
  }
  EXPECT_FALSE(MergeAndRemoveOverlaps(mesh).is_complete);
}

}  // namespace
}  // namespace evpose
