// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/loading/model_readers.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose {
namespace {

using ::testing::ElementsAre;
using ::testing::SizeIs;
using Triangle = std::array<uint32_t, 3>;
using Line = std::array<uint32_t, 2>;

template <typename Reader>
RawMesh MustRead(const Reader& reader, const std::string& text) {
  absl::StatusOr<RawMesh> mesh =
      reader({reinterpret_cast<const uint8_t*>(text.data()), text.size()}, {.max_triangles = 100});
  EXPECT_TRUE(mesh.ok()) << mesh.status();
  return mesh.ok() ? *std::move(mesh) : RawMesh();
}

TEST(ObjReaderTest, VerticesAreThoseInUseInTheOrderOfFirstUse) {
  const RawMesh mesh = MustRead(ReadObj,
                                "v 9 9 9\nv 1 0 0\nv 2 0 0\nl 3 2\no a\ng b\nf 4 2 3\nv 3 1 0\nv 4 1 0 # comment\n"
                                "f -1/7/-2 \\\n -3 -2\n");
  EXPECT_THAT(mesh.points, ElementsAre(Eigen::Vector3d(2, 0, 0), Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(3, 1, 0),
                                       Eigen::Vector3d(4, 1, 0)));
  EXPECT_THAT(mesh.lines, ElementsAre(Line{0, 1}));
  EXPECT_THAT(mesh.triangles, ElementsAre(Triangle{2, 1, 0}, Triangle{3, 0, 2}));
}

TEST(StlReaderTest, BlankLinesAndUpperCase) {
  const std::string stl =
      "\n  \r\n SOLID a\nFACET NORMAL 0 0 1\nOuter Loop\nVERTEX 1 2 3\nvertex 0 0 0\nvertex 1 0 0\nENDLOOP\n"
      "EndFacet\nENDSOLID a\n";
  const RawMesh mesh = MustRead(ReadStl, stl);
  EXPECT_THAT(mesh.triangles, SizeIs(1));
  EXPECT_THAT(mesh.points, SizeIs(3));
}

TEST(ReadersTest, CoordinatesAreCorrectlyRounded) {
  // The third has the 17 digits of a double that is halfway between two floats: the even one is nearest.
  const std::string point = "0.440789347 1.23456789e+01 -1.0000000596046448";
  const Eigen::Vector3d expected(0x1.c35e48p-2, 0x1.8b0fcep+3, -1.0);
  const std::string facet = absl::StrCat("facet normal 0 0 nan\nouter loop\nvertex ", point,
                                         "\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\n");
  EXPECT_EQ(MustRead(ReadStl, absl::StrCat("solid\n", facet, "endsolid\n")).points.at(0), expected);
  EXPECT_EQ(MustRead(ReadObj, absl::StrCat("v ", point, "\nv 0 0 0\nl 1 2\n")).points.at(0), expected);
  for (const char* type : {"float", "double"}) {
    const std::string ply = absl::StrCat("ply\nformat ascii 1.0\nelement vertex 1\nproperty ", type, " x\nproperty ",
                                         type, " y\nproperty ", type, " z\nend_header\n", point, "\n");
    EXPECT_EQ(MustRead(ReadPly, ply).points.at(0), expected);
  }
}

const Eigen::Vector3f kNoNormal = Eigen::Vector3f::Zero();

TEST(ObjReaderTest, NormalsBelongToCorners) {
  // With and without a texture coordinate, relative, of a later statement; a quadrilateral from its corner 4.
  const RawMesh mesh = MustRead(ReadObj,
                                "v 0 0 0\nv 4 1 0\nv 0 2 0\nv 1 1 0\nvn 0 0 2\nvn 3 0 4\nf 1 2 3\n"
                                "f 1//1 2/7/2 3//-1 4//3\nl 1 2\nvn 0 -5 0\nf 1//1 2 3//2\n");
  const Eigen::Vector3f z(0, 0, 1), slanted(0.6f, 0, 0.8f), y(0, -1, 0);
  ASSERT_THAT(mesh.triangles, SizeIs(4));
  EXPECT_THAT(mesh.triangles[1], Triangle({3, 0, 1}));
  EXPECT_THAT(mesh.corner_normals, ElementsAre(ElementsAre(kNoNormal, kNoNormal, kNoNormal), ElementsAre(y, z, slanted),
                                               ElementsAre(y, slanted, slanted), ElementsAre(z, kNoNormal, slanted)));
}

TEST(ObjReaderTest, UnusableNormalsAreNone) {
  const RawMesh mesh = MustRead(ReadObj,
                                "v 0 0 0\nv 4 1 0\nv 0 2 0\nvn 0 0 0\nvn -nan(ind) 0 1\nvn 1 0\nvn 1e300 1e300 1\n"
                                "f 1//1 2//2 3//3\nf 1//4 2//9 3//-9\n");
  for (const auto& normals : mesh.corner_normals) {
    EXPECT_THAT(normals, ElementsAre(kNoNormal, kNoNormal, kNoNormal));
  }
  EXPECT_THAT(MustRead(ReadObj, "v 0 0 0\nv 4 1 0\nv 0 2 0\nvn 0 0 1\nf 1 2 3\n").corner_normals, SizeIs(0));
  EXPECT_THAT(MustRead(ReadObj, "v 0 0 0\nv 4 1 0\nv 0 2 0\nf 1//1 2//1 3//1\n").corner_normals, SizeIs(0));
}

TEST(PlyReaderTest, NormalsOfVerticesAreThoseOfTheirCorners) {
  const auto ply = [](const char* third) {
    return absl::StrCat("ply\nformat ascii 1.0\nelement vertex 3\nproperty float nx\nproperty float x\n",
                        "property double ny\nproperty float y\nproperty float z\nproperty float ", third,
                        "\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n",
                        "0 0 0 0 0 2\n3 1 0 0 0 4\nnan 0 0 1 0 1\n3 0 1 2\n3 2 1 0\n");
  };
  const RawMesh mesh = MustRead(ReadPly, ply("nz"));
  const Eigen::Vector3f z(0, 0, 1), slanted(0.6f, 0, 0.8f);
  EXPECT_THAT(mesh.points, ElementsAre(Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, 1, 0)));
  EXPECT_THAT(mesh.corner_normals, ElementsAre(ElementsAre(z, slanted, kNoNormal), ElementsAre(kNoNormal, slanted, z)));
  EXPECT_THAT(MustRead(ReadPly, ply("red")).corner_normals, SizeIs(0));
}

TEST(ReadersTest, FacesOfOneOrTwoCornersHaveNoArea) {
  const char* const ply =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 3\nproperty list uchar int vertex_indices\nend_header\n"
      "0 0 0\n1 0 0\n0 1 0\n2 0 1\n3 0 1 2\n1 2\n";
  const auto expected = ElementsAre(Triangle{0, 1, 1}, Triangle{0, 1, 2}, Triangle{2, 2, 2});
  EXPECT_THAT(MustRead(ReadPly, ply).triangles, expected);
  EXPECT_THAT(MustRead(ReadObj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\nf 1 2 3\nf 3\n").triangles, expected);
}

RawMesh Polygon(const std::vector<Eigen::Vector2d>& outline) {
  RawMesh mesh;
  std::vector<uint32_t> corners;
  for (const Eigen::Vector2d& corner : outline) {
    corners.push_back(static_cast<uint32_t>(corners.size()));
    mesh.points.push_back({corner.x(), corner.y(), 0.5});
  }
  AppendPolygon(corners, mesh);
  return mesh;
}

// Returns the smallest signed area of the triangles, and their sum; an area is positive if the corners are
// counter-clockwise.
double SmallestArea(const RawMesh& mesh, double& sum) {
  double smallest = 1e9;
  sum = 0.0;
  for (const auto& [i, j, k] : mesh.triangles) {
    const double area =
        0.5 * (mesh.points[j] - mesh.points[i]).cross(mesh.points[k] - mesh.points[i]).dot(Eigen::Vector3d::UnitZ());
    smallest = std::min(smallest, area);
    sum += area;
  }
  return smallest;
}

TEST(AppendPolygonTest, DiagonalOfAQuadrilateralBeginsAtItsConcaveCorner) {
  EXPECT_THAT(Polygon({{0, 0}, {2, 0}, {2, 1}, {0, 1}}).triangles, ElementsAre(Triangle{0, 1, 2}, Triangle{0, 2, 3}));
  // An arrowhead whose corner 3 is concave.
  EXPECT_THAT(Polygon({{0, 0}, {4, 1}, {0, 2}, {1, 1}}).triangles, ElementsAre(Triangle{3, 0, 1}, Triangle{3, 1, 2}));
}

TEST(AppendPolygonTest, TrianglesCoverTheConcavePolygonOnce) {
  const std::vector<Eigen::Vector2d> u_shape = {{0, 0}, {3, 0}, {3, 2}, {2, 2}, {2, 1}, {1, 1}, {1, 2}, {0, 2}};
  // A square with a square hole, which two edges in the same place connect to the outline.
  const std::vector<Eigen::Vector2d> with_hole = {{0, 0}, {4, 0}, {4, 4}, {0, 4}, {0, 0},
                                                  {1, 1}, {1, 3}, {3, 3}, {3, 1}, {1, 1}};
  for (const auto& [outline, area] : {std::make_pair(u_shape, 5.0), std::make_pair(with_hole, 12.0)}) {
    for (size_t turn = 0; turn < outline.size(); ++turn) {
      std::vector<Eigen::Vector2d> turned(outline.begin() + turn, outline.end());
      turned.insert(turned.end(), outline.begin(), outline.begin() + turn);
      double sum;
      const RawMesh mesh = Polygon(turned);
      EXPECT_GE(SmallestArea(mesh, sum), 0.0);
      EXPECT_NEAR(sum, area, 1e-9);
      EXPECT_THAT(mesh.triangles, SizeIs(outline.size() - 2));
    }
  }
}

TEST(AppendPolygonTest, PolygonThatCrossesItselfEnds) {
  // A star drawn in one stroke has no ear at all.
  EXPECT_THAT(Polygon({{0, 3}, {2, -3}, {-3, 1}, {3, 1}, {-2, -3}}).triangles, SizeIs(testing::Le(3u)));
}

}  // namespace
}  // namespace evpose
