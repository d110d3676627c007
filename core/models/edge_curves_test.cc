// SPDX-License-Identifier: Apache-2.0
#include "core/models/edge_curves.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/models/cube_files_testing.h"

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

TEST(EdgeCurvesTest, HoleOfAPlateHasTwoRings) {
  const ObjectModel plate = MustParse(PlateWithHole(32));
  EXPECT_THAT(plate.lines, SizeIs(12));
  ASSERT_THAT(plate.curves, SizeIs(2));
  for (const EdgeCurve& rim : plate.curves) {
    EXPECT_TRUE(rim.is_ring());
    EXPECT_EQ(rim.kind, EdgeKind::kCrease);
    EXPECT_THAT(rim.points, SizeIs(33));
    EXPECT_NEAR(rim.turn_rad, M_PI / 2, 1e-6);
    ASSERT_THAT(rim.face_normals, SizeIs(32));
    for (size_t i = 0; i < 32; ++i) {
      const Eigen::Vector3d middle = 0.5 * (rim.points[i] + rim.points[i + 1]);
      const Eigen::Vector3d inward = -Eigen::Vector3d(middle.x(), middle.y(), 0.0).normalized();
      const Eigen::Vector3d face(0, 0, middle.z() > 0.1 ? 1 : -1);
      const auto& normals = rim.face_normals[i];
      EXPECT_GT(std::max(normals[0].dot(inward), normals[1].dot(inward)), 0.999) << "the wall of the hole";
      EXPECT_GT(std::max(normals[0].dot(face), normals[1].dot(face)), 0.999999);
    }
  }
  EXPECT_THAT(plate.surface.regions, SizeIs(7));
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

}  // namespace
}  // namespace evpose
