// SPDX-License-Identifier: Apache-2.0
#include "core/models/edge_curves.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/models/cube_files_testing.h"
#include "core/models/model_lines.h"

namespace evpose {
namespace {

using ::testing::IsEmpty;
using ::testing::SizeIs;

// A square plate of side 2 and height 0.2 with a hole of radius 0.5 and so many sides.
std::string PlateWithHole(int sides) {
  std::string obj;
  for (const double z : {0.0, 0.2}) {
    absl::StrAppendFormat(&obj, "v -1 -1 %g\nv 1 -1 %g\nv 1 1 %g\nv -1 1 %g\n", z, z, z, z);
    for (int i = 0; i < sides; ++i) {
      // Counter-clockwise, the first quarter before the corner at (-1, -1).
      const double angle = -M_PI + 2 * M_PI * i / sides;
      absl::StrAppendFormat(&obj, "v %.9g %.9g %g\n", 0.5 * std::cos(angle), 0.5 * std::sin(angle), z);
    }
  }
  const int top = 4 + sides, quarter = sides / 4;
  for (int side = 0; side < 4; ++side) {
    const int next = (side + 1) % 4;
    absl::StrAppendFormat(&obj, "f %d %d %d %d\n", 1 + side, 1 + next, 1 + next + top, 1 + side + top);
    for (int i = 0; i < quarter; ++i) {
      const int a = 5 + side * quarter + i, b = 5 + (side * quarter + i + 1) % sides;
      absl::StrAppendFormat(&obj, "f %d %d %d\nf %d %d %d\n", 1 + side, b, a, 1 + side + top, a + top, b + top);
      absl::StrAppendFormat(&obj, "f %d %d %d %d\n", b, a, a + top, b + top);
    }
    const int last = 5 + ((side + 1) * quarter) % sides;
    absl::StrAppendFormat(&obj, "f %d %d %d\nf %d %d %d\n", 1 + side, 1 + next, last, 1 + side + top, last + top,
                          1 + next + top);
  }
  return obj;
}

TEST(EdgeCurvesTest, HoleOfAPlateHasTwoCircles) {
  for (const int sides : {16, 24, 32, 60, 120}) {
    const ObjectModel plate = MustParse(PlateWithHole(sides));
    EXPECT_THAT(plate.lines, SizeIs(12));
    EXPECT_THAT(plate.surface.regions, SizeIs(7));
    ASSERT_THAT(plate.curves, SizeIs(2)) << sides;
    for (const EdgeCurve& rim : plate.curves) {
      EXPECT_TRUE(rim.is_ring());
      EXPECT_EQ(rim.kind, EdgeKind::kCrease);
      EXPECT_NEAR(rim.turn_rad, M_PI / 2, 1e-6);
      ASSERT_THAT(rim.face_normals, SizeIs(rim.points.size() - 1));
      for (size_t i = 0; i < rim.face_normals.size(); ++i) {
        const Eigen::Vector3d middle = 0.5 * (rim.points[i] + rim.points[i + 1]);
        EXPECT_NEAR(middle.head<2>().norm(), 0.5, 2.1e-5 * plate.diameter_m) << sides;
        const Eigen::Vector3d inward = -Eigen::Vector3d(middle.x(), middle.y(), 0.0).normalized();
        const Eigen::Vector3d face(0, 0, middle.z() > 0.1 ? 1 : -1);
        const auto& normals = rim.face_normals[i];
        EXPECT_GT(std::max(normals[0].dot(inward), normals[1].dot(inward)), 0.999999) << "the wall of the hole";
        EXPECT_GT(std::max(normals[0].dot(face), normals[1].dot(face)), 0.999999);
      }
    }
  }
}

TEST(EdgeCurvesTest, HoleOfEightSidesIsAPrism) {
  const ObjectModel plate = MustParse(PlateWithHole(8));
  EXPECT_THAT(plate.lines, SizeIs(12 + 24));
  EXPECT_THAT(plate.curves, IsEmpty());
  EXPECT_TRUE(plate.surface.empty());
}

TEST(EdgeCurvesTest, PrismaticModelsHaveTheLinesOfTheirFacets) {
  for (const std::string& obj : {Cube(), Prism(3), Prism(6), Prism(8), Prism(10), PlateWithHole(8),
                                 std::string("v 0 0 0\nv 3 0 0\nv 3 0 1\nv 0 0 1\nf 1 2 3 4\n"
                                             "v 1 0 1\nv 2 0 1\nv 2 1 2\nv 1 1 2\nf 5 6 7 8\n")}) {
    const ObjectModel smooth = MustParse(obj), facets = MustParse(obj, ModelFormat::kObj, AsIs());
    EXPECT_THAT(smooth.curves, IsEmpty());
    EXPECT_TRUE(smooth.surface.empty());
    ASSERT_EQ(smooth.lines.size(), facets.lines.size());
    for (size_t i = 0; i < smooth.lines.size(); ++i) {
      EXPECT_EQ(smooth.lines[i].p1, facets.lines[i].p1);
      EXPECT_EQ(smooth.lines[i].p2, facets.lines[i].p2);
      EXPECT_EQ(smooth.lines[i].face_normals, facets.lines[i].face_normals);
      EXPECT_EQ(smooth.lines[i].kind, facets.lines[i].kind);
    }
    EXPECT_EQ(smooth.symmetries.size(), facets.symmetries.size());
  }
}

// A disc of many corners, cut into triangles.
std::string Disc(int corners) {
  std::string obj = "v 0 0 0\n";
  for (int i = 0; i < corners; ++i) {
    const double angle = 2 * M_PI * i / corners;
    absl::StrAppendFormat(&obj, "v %.9g %.9g 0\n", std::cos(angle), std::sin(angle));
  }
  for (int i = 0; i < corners; ++i) absl::StrAppendFormat(&obj, "f 1 %d %d\n", i + 2, (i + 1) % corners + 2);
  return obj;
}

TEST(EdgeCurvesTest, RimOfADiscIsOneCurve) {
  const ObjectModel model = MustParse(Disc(360));
  EXPECT_THAT(model.lines, IsEmpty());
  ASSERT_THAT(model.curves, SizeIs(1));
  EXPECT_TRUE(model.curves[0].is_ring());
  EXPECT_EQ(model.curves[0].kind, EdgeKind::kBoundary);
  EXPECT_THAT(model.curves[0].points, SizeIs(361));
  for (const auto& normals : model.curves[0].face_normals) {
    EXPECT_NEAR(normals[0].z(), 1.0, 1e-12);
    EXPECT_TRUE(normals[1].isZero());
  }
  EXPECT_TRUE(model.surface.empty()) << "a disc is flat";
}

TEST(EdgeCurvesTest, FacetsThatAreTheSurfaceHaveStraightEdges) {
  const ObjectModel disc = MustParse(Disc(360), ModelFormat::kObj, AsIs());
  EXPECT_THAT(disc.lines, SizeIs(360));
  EXPECT_THAT(disc.curves, IsEmpty());
  const ObjectModel prism = MustParse(Prism(16), ModelFormat::kObj, AsIs());
  EXPECT_THAT(prism.lines, SizeIs(32));
  EXPECT_TRUE(prism.surface.empty());
}

TEST(EdgeCurvesTest, RingOfEdgesThatHardlyTurnIsCutNotJoinedToAPoint) {
  const ObjectModel model = MustParse(Disc(5000), ModelFormat::kObj, AsIs());
  double length = 0.0;
  for (const ModelLine& line : model.lines) {
    length += (line.p2 - line.p1).norm();
    EXPECT_GT((0.5 * (line.p1 + line.p2)).norm(), 1.0 - 1e-4);
  }
  EXPECT_NEAR(length, 2 * M_PI, 1e-3);
  EXPECT_LT(model.lines.size(), 1000u);
}

TEST(EdgeCurvesTest, PolylineOfManyShortPartsIsAPaintedCurve) {
  std::string obj = Cube();
  std::string polyline = "l 5 7\nl";
  for (int i = 0; i <= 12; ++i) {
    absl::StrAppendFormat(&obj, "v %.9g %.9g 1\n", 0.5 + 0.3 * std::cos(M_PI / 6 * i),
                          0.5 + 0.3 * std::sin(M_PI / 6 * i));
    absl::StrAppend(&polyline, " ", 9 + i);
  }
  const ObjectModel model = MustParse(absl::StrCat(obj, polyline, "\n"));
  EXPECT_THAT(model.lines, SizeIs(1));
  ASSERT_THAT(model.curves, SizeIs(1));
  EXPECT_EQ(model.curves[0].kind, EdgeKind::kPainted);
  EXPECT_TRUE(model.curves[0].is_ring());
  EXPECT_THAT(model.curves[0].points, SizeIs(12 * 18 + 1));
  for (const auto& normals : model.curves[0].face_normals) EXPECT_NEAR(normals[0].z(), 1.0, 1e-9);
  const ObjectModel back = MustParse(ObjectModelToObj(model));
  EXPECT_THAT(back.lines, SizeIs(1));
  ASSERT_THAT(back.curves, SizeIs(1));
  ASSERT_EQ(back.curves[0].points.size(), model.curves[0].points.size());
  for (const ObjectModel* read : {&model, &back}) {
    for (const Eigen::Vector3d& point : read->curves[0].points) {
      EXPECT_NEAR((point - Eigen::Vector3d(0.5, 0.5, 1.0)).norm(), 0.3, 1e-6);
    }
  }
}

TEST(EdgeCurvesTest, ManyLinesAreNoReasonToRefuse) {
  // A comb of 3000 separate squares: 12,000 lines.
  std::string obj;
  constexpr int kSquares = 3000;
  for (int i = 0; i < kSquares; ++i) {
    const int x = i % 60, y = i / 60;
    absl::StrAppendFormat(&obj, "v %d %d 0\nv %g %d 0\nv %g %g 0\nv %d %g 0\nf -4 -3 -2 -1\n", x, y, x + 0.5, y,
                          x + 0.5, y + 0.5, x, y + 0.5);
  }
  EXPECT_THAT(MustParse(obj).lines, SizeIs(4 * kSquares));
}

TEST(EdgeCurvesTest, KindsOfLines) {
  const ObjectModel sheet = MustParse("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n");
  for (const ModelLine& line : sheet.lines) EXPECT_EQ(line.kind, EdgeKind::kBoundary);
  for (const ModelLine& line : MustParse(Cube()).lines) EXPECT_EQ(line.kind, EdgeKind::kCrease);
  const ObjectModel painted = MustParse(absl::StrCat(Cube(), "l 5 6\nl 5 7\n"));
  ASSERT_THAT(painted.lines, SizeIs(2));
  EXPECT_EQ(painted.lines[0].kind, EdgeKind::kCrease) << "along an edge of the mesh";
  EXPECT_EQ(painted.lines[1].kind, EdgeKind::kPainted);
}

TEST(EdgeCurvesTest, PaintedPolygonsStayLines) {
  std::string obj = Cube(), hexagon = "l", square = "l 5 6 7 8 5\n";
  for (int i = 0; i <= 6; ++i) {
    absl::StrAppendFormat(&obj, "v %.9g %.9g 1\n", 0.5 + 0.3 * std::cos(M_PI / 3 * i),
                          0.5 + 0.3 * std::sin(M_PI / 3 * i));
    absl::StrAppend(&hexagon, " ", 9 + i);
  }
  const ObjectModel model = MustParse(absl::StrCat(obj, square, hexagon, "\n"));
  EXPECT_THAT(model.lines, SizeIs(10));
  EXPECT_THAT(model.curves, IsEmpty());
}

// A tube along z between two heights, or, with an inner and an outer radius, both walls and their rings.
void AppendPipe(double inner, double outer, double low, double high, int sides, std::string& obj) {
  const int first = static_cast<int>(std::count(obj.begin(), obj.end(), 'v')) + 1;
  for (int i = 0; i < sides; ++i) {
    const double x = std::cos(2 * M_PI * i / sides), y = std::sin(2 * M_PI * i / sides);
    for (const auto& [radius, z] : {std::pair(inner, low), {outer, low}, {outer, high}, {inner, high}}) {
      absl::StrAppendFormat(&obj, "v %.9g %.9g %g\n", radius * x, radius * y, z);
    }
  }
  for (int i = 0; i < sides; ++i) {
    const int a = first + 4 * i, b = first + 4 * ((i + 1) % sides);
    for (int k = 0; k < 4; ++k) {
      absl::StrAppendFormat(&obj, "f %d %d %d %d\n", a + k, b + k, b + (k + 1) % 4, a + (k + 1) % 4);
    }
  }
}

TEST(EdgeCurvesTest, NoEdgeIsSeenWhereTheBoresOfTwoBodiesMeet) {
  for (const int sides : {24, 48, 120}) {
    // A hub on a disc, with the same bore: each has a ring where they touch, of which one is the larger.
    std::string obj;
    AppendPipe(0.3, 1.0, 0.0, 0.3, sides, obj);
    AppendPipe(0.3, 0.6, 0.3, 1.0, sides, obj);
    const ObjectModel model = MustParse(obj);
    EXPECT_THAT(model.lines, IsEmpty()) << sides;
    std::vector<std::pair<double, double>> rims;  // radius and height
    for (const EdgeCurve& curve : model.curves) {
      EXPECT_TRUE(curve.is_ring());
      rims.emplace_back(std::round(10 * curve.points[0].head<2>().norm()) / 10, curve.points[0].z());
    }
    const auto rim = [](double radius, double z) {
      return ::testing::Pair(::testing::DoubleNear(radius, 1e-6), ::testing::DoubleNear(z, 1e-6));
    };
    EXPECT_THAT(rims, ::testing::UnorderedElementsAre(rim(0.3, 0), rim(1, 0), rim(1, 0.3), rim(0.6, 0.3), rim(0.6, 1),
                                                      rim(0.3, 1)))
        << sides;
  }
}

TEST(EdgeCurvesTest, TheFootOfASheetWithTwoSidesIsAnEdge) {
  // A square of two triangles per half, and a sheet that stands on its middle.
  const ObjectModel model = MustParse(
      "v -1 -1 0\nv 0 -1 0\nv 1 -1 0\nv 1 1 0\nv 0 1 0\nv -1 1 0\nv 0 -1 1\nv 0 1 1\n"
      "f 1 2 5 6\nf 2 3 4 5\nf 2 5 8 7\nf 7 8 5 2\n");
  const auto is_foot = [](const ModelLine& line) {
    return std::abs(line.p1.x()) + std::abs(line.p2.x()) + std::abs(line.p1.z()) + std::abs(line.p2.z()) < 1e-9;
  };
  EXPECT_EQ(std::count_if(model.lines.begin(), model.lines.end(), is_foot), 1);
}

// Each line is inside all of 100 faces.
TEST(EdgeCurvesTest, TheFacesThatAreSearchedForPaintedLinesAreBounded) {
  constexpr uint32_t kFaces = 100, kLines = 20;
  RawMesh mesh;
  mesh.points = {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}};
  mesh.triangles.assign(kFaces, {0, 1, 2});
  for (uint32_t i = 0; i < kLines; ++i) {
    mesh.points.emplace_back(0.5, 0.5 + 0.01 * i, 0);
    mesh.points.emplace_back(1.5, 0.5 + 0.01 * i, 0);
    mesh.lines.push_back({3 + 2 * i, 4 + 2 * i});
  }
  const TriangleBvh faces(mesh.points, mesh.triangles);
  std::vector<std::string> notices;
  // Two lines with five samples, each beside all faces, are beyond 999.
  const std::vector<ModelLine> lines = PaintedLines(mesh, faces, 4.0, notices, /*max_faces=*/999);
  ASSERT_THAT(lines, SizeIs(kLines));
  for (size_t i = 0; i < kLines; ++i) EXPECT_EQ(lines[i].face_normals.size(), i < 2 ? 1u : 0u) << i;
  EXPECT_THAT(notices, testing::ElementsAre("the faces of 18 lines were not searched: too many are near lines"));
  notices.clear();
  EXPECT_THAT(PaintedLines(mesh, faces, 4.0, notices).back().face_normals, SizeIs(1));
  EXPECT_THAT(notices, IsEmpty());
}

}  // namespace
}  // namespace evpose
