// SPDX-License-Identifier: Apache-2.0
#include "core/models/object_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "core/models/cube_files_testing.h"

namespace evpose {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

double SignedVolume(const ObjectModel& model) {
  double volume = 0.0;
  for (const auto& [i, j, k] : model.triangles) {
    volume += model.vertices[i].dot(model.vertices[j].cross(model.vertices[k])) / 6.0;
  }
  return volume;
}

// The ends of the lines as a set, independent of order and direction.
std::multiset<std::string> LineSet(const ObjectModel& model) {
  std::multiset<std::string> set;
  for (const ModelLine& line : model.lines) {
    const auto name = [](const Eigen::Vector3d& p) { return absl::StrFormat("(%.5g %.5g %.5g)", p.x(), p.y(), p.z()); };
    const std::string a = name(line.p1), b = name(line.p2);
    set.insert(std::min(a, b) + std::max(a, b));
  }
  return set;
}

void ExpectIsUnitCube(const ObjectModel& model) {
  EXPECT_THAT(model.vertices, SizeIs(8));
  EXPECT_THAT(model.triangles, SizeIs(12));
  ASSERT_THAT(model.lines, SizeIs(12));
  EXPECT_NEAR(model.diameter_m, std::sqrt(3.0), 1e-6);
  EXPECT_NEAR(SignedVolume(model), 1.0, 1e-6);
  for (const ModelLine& line : model.lines) {
    EXPECT_NEAR((line.p2 - line.p1).norm(), 1.0, 1e-6);
    ASSERT_THAT(line.face_normals, SizeIs(2));
    EXPECT_NEAR(line.face_normals[0].dot(line.face_normals[1]), 0.0, 1e-6);
    for (const Eigen::Vector3d& normal : line.face_normals) {
      EXPECT_NEAR(normal.norm(), 1.0, 1e-12);
      EXPECT_GT(normal.dot(0.5 * (line.p1 + line.p2) - Eigen::Vector3d(0.5, 0.5, 0.5)), 0.4);  // outward
    }
  }
}

// --- Formats

TEST(ObjectModelTest, CubeFromObj) { ExpectIsUnitCube(MustParse(Cube())); }

TEST(ObjectModelTest, CubeFromTrianglesHasNoDiagonals) {
  const ObjectModel cube = MustParse(Cube());
  std::string obj = kCubeVertices;
  for (const auto& [i, j, k] : MustParse(Cube()).triangles) {
    for (const uint32_t v : {i, j, k}) {
      absl::StrAppend(&obj, v == i ? "f " : " ");
      const Eigen::Vector3d& p = cube.vertices[v];
      absl::StrAppend(&obj, 1 + (p.z() > 0.5 ? 4 : 0) + (p.y() > 0.5 ? (p.x() > 0.5 ? 2 : 3) : (p.x() > 0.5 ? 1 : 0)));
    }
    obj += "\n";
  }
  ExpectIsUnitCube(MustParse(obj));
}

TEST(ObjectModelTest, CubeFromPly) {
  ExpectIsUnitCube(MustParse(AsciiPly(), ModelFormat::kPly));
  ExpectIsUnitCube(MustParse(BinaryPly(false), ModelFormat::kPly));
  ExpectIsUnitCube(MustParse(BinaryPly(true), ModelFormat::kPly));
}

TEST(ObjectModelTest, CubeFromStl) {
  const ObjectModel cube = MustParse(Cube());
  ExpectIsUnitCube(MustParse(AsciiStl(cube), ModelFormat::kStl));
  ExpectIsUnitCube(MustParse(BinaryStl(cube), ModelFormat::kStl));
}

TEST(ObjectModelTest, StlCornersThatDifferByARoundingAreMerged) {
  const std::string stl = AsciiStl(MustParse(Cube()));
  std::string shaken;
  int count = 0;
  for (size_t i = 0; i < stl.size(); ++i) {
    shaken += stl[i];
    if (stl.compare(i, 8, "vertex 1") == 0) {
      shaken += stl.substr(i + 1, 7) + absl::StrCat(".000000", count++ % 3);
      i += 7;
    }
  }
  EXPECT_GT(count, 5);
  ExpectIsUnitCube(MustParse(shaken, ModelFormat::kStl));
}

TEST(ObjectModelTest, ObjDialects) {
  const std::string crlf = absl::StrReplaceAll(Cube(), {{"\n", "\r\n"}});
  ExpectIsUnitCube(MustParse(crlf));
  const std::string commented = absl::StrReplaceAll(Cube(), {{"\n", " # why not\n"}, {"f ", "  f\t"}});
  ExpectIsUnitCube(MustParse(commented));
  ExpectIsUnitCube(MustParse(absl::StrReplaceAll(Cube(), {{"f 1 4 3 2", "f 1 4 \\\n3 2"}})));
  ExpectIsUnitCube(
      MustParse(absl::StrCat("mtllib no/such.mtl\no cube\n", kCubeVertices, "vn 0 0 1\nvt 0 0\nusemtl red\n",
                             "g side\ns off\n", absl::StrReplaceAll(kCubeFaces, {{" 4", " 4/1/1"}}))));
  ExpectIsUnitCube(MustParse(absl::StrCat(kCubeFaces, kCubeVertices)));  // faces first
  ExpectIsUnitCube(MustParse(
      absl::StrCat(kCubeVertices, "f -8 -5 -6 -7\nf -4 -3 -2 -1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8")));
}

TEST(ObjectModelTest, ObjNumbers) {
  const ObjectModel model = MustParse("v .5 +1 -.25\nv 1e-1 2. 1E2\nl 1 2\n");
  EXPECT_EQ(model.lines[0].p1, Eigen::Vector3d(0.5, 1, -0.25));
  EXPECT_EQ(model.lines[0].p2, Eigen::Vector3d(0.1f, 2, 100));
}

TEST(ObjectModelTest, MaterialFilesAreNotOpened) {
  // A pipe without a writer: opening it would block.
  const std::string pipe = testing::TempDir() + "/evpose_object_model_test.mtl";
  ExpectIsUnitCube(MustParse(absl::StrCat("mtllib ", pipe, "\nmtllib /etc/passwd\n", Cube())));
}

TEST(ObjectModelTest, UnitScale) {
  ModelOptions options;
  options.metres_per_unit = 0.001;
  const ObjectModel model = MustParse(Cube(), ModelFormat::kObj, options);
  EXPECT_NEAR(model.diameter_m, 0.001 * std::sqrt(3.0), 1e-9);
  EXPECT_NEAR((model.lines[0].p2 - model.lines[0].p1).norm(), 0.001, 1e-9);
}

// --- Lines

TEST(ObjectModelTest, LineElementsReplaceEdges) {
  // Along an edge, across the middle of the top, from the cube into the air, and far from it.
  const ObjectModel model = MustParse(absl::StrCat(Cube(), "v 0.2 0.5 1\nv 0.8 0.5 1\nv 2 2 2\nv 3 2 2\nv 0.5 0.5 3\n",
                                                   "l 5 6\nl 9 10\nl 11 12\nl 9 13\n"));
  ASSERT_THAT(model.lines, SizeIs(4));
  EXPECT_THAT(model.lines[0].face_normals, SizeIs(2));
  EXPECT_EQ(model.lines[0].p1, Eigen::Vector3d(0, 0, 1));
  EXPECT_EQ(model.lines[0].p2, Eigen::Vector3d(1, 0, 1));
  ASSERT_THAT(model.lines[1].face_normals, SizeIs(1));
  EXPECT_NEAR(model.lines[1].face_normals[0].z(), 1.0, 1e-9);
  EXPECT_THAT(model.lines[2].face_normals, IsEmpty());
  EXPECT_THAT(model.lines[3].face_normals, IsEmpty());
  EXPECT_THAT(model.vertices, SizeIs(8));
  EXPECT_NEAR(model.diameter_m, std::sqrt(17.0), 1e-6);  // the lines are part of it
  EXPECT_THAT(model.notices, ElementsAre(HasSubstr("the line elements (l) of the file, 4.622 m in all")));
}

TEST(ObjectModelTest, LineOnTheDiagonalOfAFaceHasOneNormal) {
  const ObjectModel model = MustParse(absl::StrCat(Cube(), "l 5 7\nl 6 8\n"));
  ASSERT_THAT(model.lines, SizeIs(2));
  for (const ModelLine& line : model.lines) {
    ASSERT_THAT(line.face_normals, SizeIs(1));
    EXPECT_NEAR(line.face_normals[0].z(), 1.0, 1e-9);
  }
}

TEST(ObjectModelTest, LineOnTheFrontOfAThinPlate) {
  // 1 m x 1 m x 0.5 mm.
  const ObjectModel model = MustParse(absl::StrCat(absl::StrReplaceAll(kCubeVertices, {{" 1\n", " 0.0005\n"}}),
                                                   kCubeFaces, "v 0.2 0.5 0.0005\nv 0.8 0.4 0.0005\nl 9 10\n"));
  ASSERT_THAT(model.lines, SizeIs(1));
  ASSERT_THAT(model.lines[0].face_normals, SizeIs(1));
  EXPECT_NEAR(model.lines[0].face_normals[0].z(), 1.0, 1e-9);
}

TEST(ObjectModelTest, PolylinesAreConsecutivePairs) {
  const ObjectModel model = MustParse(absl::StrCat(kCubeVertices, "l 1 2 3 4 1\n"));
  EXPECT_THAT(LineSet(model),
              testing::UnorderedElementsAre("(0 0 0)(1 0 0)", "(1 0 0)(1 1 0)", "(0 1 0)(1 1 0)", "(0 0 0)(0 1 0)"));
  EXPECT_THAT(model.triangles, IsEmpty());
  EXPECT_THAT(model.vertices, IsEmpty());
  EXPECT_NEAR(model.diameter_m, std::sqrt(2.0), 1e-9);
}

TEST(ObjectModelTest, DuplicateAndEmptyLinesAreDroppedWithANotice) {
  const ObjectModel model =
      MustParse(absl::StrCat(kCubeVertices, "v 1 0 0\nl 1 2\nl 2 1\nl 9 1\nl 3 3\nl 2 9\nl 3 4\n"));
  EXPECT_THAT(model.lines, SizeIs(2));
  EXPECT_THAT(model.notices, Contains("2 lines of length zero dropped"));
  EXPECT_THAT(model.notices, Contains("2 duplicate lines dropped"));
}

TEST(ObjectModelTest, OverlappingLinesAreOne) {
  // A part of another, the same backwards in two pieces, one that sticks out at each end; and two that only touch.
  const std::string points = "v 0 0 0\nv 1 0 0\nv 0.25 0 0\nv 0.5 0 0\nv 1.5 0 0\nv -1 0 0\nv 0 1 0\nv 0 2 0\n";
  const ObjectModel part = MustParse(points + "l 1 2\nl 3 4\nl 1 7\nl 7 8\n");
  EXPECT_THAT(LineSet(part), testing::UnorderedElementsAre("(0 0 0)(1 0 0)", "(0 0 0)(0 1 0)", "(0 1 0)(0 2 0)"));
  EXPECT_THAT(part.notices, ElementsAre("1 line merged with overlapping ones", HasSubstr("no faces")));
  const ObjectModel pieces = MustParse(points + "l 1 2\nl 2 4 1\n");
  EXPECT_THAT(LineSet(pieces), testing::UnorderedElementsAre("(0 0 0)(1 0 0)"));
  EXPECT_THAT(pieces.notices, ElementsAre("2 lines merged with overlapping ones", HasSubstr("no faces")));
  const ObjectModel longer = MustParse(points + "l 4 5\nl 2 1\nl 6 3\n");
  EXPECT_THAT(LineSet(longer), testing::UnorderedElementsAre("(-1 0 0)(1.5 0 0)"));
  EXPECT_THAT(longer.notices, ElementsAre("2 lines merged with overlapping ones", HasSubstr("no faces")));
}

TEST(ObjectModelTest, LinesNearEachOtherAreTwo) {
  // Parallel at a ten-thousandth of the size, and crossing at a small angle.
  EXPECT_THAT(MustParse("v 0 0 0\nv 1 0 0\nv 0.2 1e-4 0\nv 0.8 1e-4 0\nl 1 2\nl 3 4\n").lines, SizeIs(2));
  EXPECT_THAT(MustParse("v 0 0 0\nv 1 0 0\nv 0 -1e-3 0\nv 1 1e-3 0\nl 1 2\nl 3 4\n").lines, SizeIs(2));
}

TEST(ObjectModelTest, AnEdgeThatLiesOnALongerOneSplitsItInEveryMeshFormat) {
  // The roof's eaves lie on the wall's upper edge, which is longer: between the eaves' ends it has two faces.
  const std::string obj =
      "v 0 0 0\nv 3 0 0\nv 3 0 1\nv 0 0 1\nf 1 2 3 4\n"
      "v 1 0 1\nv 2 0 1\nv 2 1 2\nv 1 1 2\nf 5 6 7 8\n";
  const ObjectModel model = MustParse(obj);
  const ObjectModel from_stl = MustParse(AsciiStl(model), ModelFormat::kStl);
  const ObjectModel from_ply = MustParse(
      "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
      "0 0 0\n3 0 0\n3 0 1\n0 0 1\n1 0 1\n2 0 1\n2 1 2\n1 1 2\n4 0 1 2 3\n4 4 5 6 7\n",
      ModelFormat::kPly);
  for (const ObjectModel* loaded : {&model, &from_stl, &from_ply}) {
    EXPECT_THAT(loaded->lines, SizeIs(9));
    // The STL file was written with the split triangles.
    if (loaded != &from_stl) {
      EXPECT_THAT(loaded->notices, Contains("1 edge split at vertices of other triangles"));
    }
    std::vector<std::pair<double, size_t>> upper;  // middle, and number of faces
    for (const ModelLine& line : loaded->lines) {
      if (line.p1.z() != 1.0 || line.p2.z() != 1.0) continue;
      upper.emplace_back(0.5 * (line.p1 + line.p2).x(), line.face_normals.size());
    }
    EXPECT_THAT(upper, testing::UnorderedElementsAre(std::pair(0.5, 1u), std::pair(1.5, 2u), std::pair(2.5, 1u)));
  }
}

TEST(ObjectModelTest, SheetHasItsBoundary) {
  const ObjectModel model = MustParse("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n");
  ASSERT_THAT(model.lines, SizeIs(4));
  for (const ModelLine& line : model.lines) {
    ASSERT_THAT(line.face_normals, SizeIs(1));
    EXPECT_NEAR(line.face_normals[0].z(), 1.0, 1e-12);
  }
}

// An n x n grid of squares, cut into triangles, at z = 0.1.
std::string Grid(int n, double scale) {
  std::string obj;
  for (int y = 0; y <= n; ++y) {
    for (int x = 0; x <= n; ++x) absl::StrAppendFormat(&obj, "v %.9g %.9g 0.1\n", scale * x / n, scale * y / n);
  }
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) {
      const int a = y * (n + 1) + x + 1, b = a + n + 1;
      absl::StrAppendFormat(&obj, "f %d %d %d\nf %d %d %d\n", a, a + 1, b + 1, a, b + 1, b);
    }
  }
  return obj;
}

TEST(ObjectModelTest, CollinearEdgesAreJoined) {
  const ObjectModel model = MustParse(Grid(37, 0.3));
  EXPECT_THAT(LineSet(model), testing::UnorderedElementsAre("(0 0 0.1)(0 0.3 0.1)", "(0 0 0.1)(0.3 0 0.1)",
                                                            "(0 0.3 0.1)(0.3 0.3 0.1)", "(0.3 0 0.1)(0.3 0.3 0.1)"));
}

TEST(ObjectModelTest, CreaseAngle) {
  // 8 sides turn by 45 degrees, 16 by 22.5.
  EXPECT_THAT(MustParse(Prism(8)).lines, SizeIs(24));
  const ObjectModel round = MustParse(Prism(16));
  EXPECT_THAT(round.lines, IsEmpty());
  ASSERT_THAT(round.curves, SizeIs(2));
  for (const EdgeCurve& rim : round.curves) {
    EXPECT_TRUE(rim.is_ring());
    EXPECT_THAT(rim.points, SizeIs(16 * 21 + 1)) << "20 points on the circle between two vertices";
    EXPECT_NEAR(rim.turn_rad, M_PI / 2, 1e-6);
  }
  EXPECT_THAT(round.surface.regions, SizeIs(3));
  ModelOptions options;
  options.crease_angle_deg = 20.0;
  const ObjectModel prism = MustParse(Prism(16), ModelFormat::kObj, options);
  EXPECT_THAT(prism.lines, SizeIs(48));
  EXPECT_THAT(prism.curves, IsEmpty());
  EXPECT_TRUE(prism.surface.empty());
}

std::string Sphere(int rings, int sectors) {
  std::string obj = "v 0 0 1\n";
  for (int i = 1; i < rings; ++i) {
    for (int j = 0; j < sectors; ++j) {
      const double theta = M_PI * i / rings, phi = 2 * M_PI * j / sectors;
      absl::StrAppendFormat(&obj, "v %.9g %.9g %.9g\n", std::sin(theta) * std::cos(phi),
                            std::sin(theta) * std::sin(phi), std::cos(theta));
    }
  }
  obj += "v 0 0 -1\n";
  const int last = 2 + (rings - 1) * sectors;
  for (int j = 0; j < sectors; ++j) {
    const int next = (j + 1) % sectors;
    absl::StrAppendFormat(&obj, "f 1 %d %d\n", 2 + j, 2 + next);
    for (int i = 0; i + 2 < rings; ++i) {
      const int a = 2 + i * sectors, b = a + sectors;
      absl::StrAppendFormat(&obj, "f %d %d %d %d\n", a + j, b + j, b + next, a + next);
    }
    absl::StrAppendFormat(&obj, "f %d %d %d\n", last, last - sectors + next, last - sectors + j);
  }
  return obj;
}

TEST(ObjectModelTest, SphereHasNoEdgeButACurvedSurface) {
  const ObjectModel sphere = MustParse(Sphere(24, 48));
  EXPECT_THAT(sphere.lines, IsEmpty());
  EXPECT_THAT(sphere.curves, IsEmpty());
  ASSERT_THAT(sphere.surface.regions, SizeIs(1));
  EXPECT_FALSE(sphere.surface.regions[0].is_flat());
  for (size_t t = 0; t < sphere.triangles.size(); ++t) {
    for (int corner = 0; corner < 3; ++corner) {
      const Eigen::Vector3d& outward = sphere.vertices[sphere.triangles[t][corner]];
      EXPECT_GT(sphere.surface.normals[t][corner].cast<double>().dot(outward), 0.9995);
    }
  }
}

TEST(ObjectModelTest, FacetsThatAreTheSurfaceHaveEdgesThatMayBeContours) {
  const ObjectModel sphere = MustParse(Sphere(24, 48), ModelFormat::kObj, AsIs());
  EXPECT_THAT(sphere.lines, IsEmpty());
  EXPECT_TRUE(sphere.surface.empty());
  // All edges of the triangles and quadrangles, but not the diagonals of the latter.
  EXPECT_THAT(sphere.facet_edges, SizeIs(23 * 48 + 24 * 48));
  for (const auto& [first, second] : sphere.facet_edges) {
    for (uint32_t corner = 0; corner < 2; ++corner) {
      EXPECT_EQ(sphere.triangles[first / 3][(first + corner) % 3],
                sphere.triangles[second / 3][(second + 1 - corner) % 3]);
    }
  }
  EXPECT_THAT(MustParse(Prism(16), ModelFormat::kObj, AsIs()).facet_edges, SizeIs(16));
  EXPECT_THAT(MustParse(Prism(8), ModelFormat::kObj, AsIs()).facet_edges, IsEmpty()) << "these are lines";
  EXPECT_THAT(MustParse(Prism(16)).facet_edges, IsEmpty()) << "the surface is smooth";
  ModelOptions sharp = AsIs();
  sharp.crease_angle_deg = 20.0;
  const ObjectModel prism = MustParse(Prism(16), ModelFormat::kObj, sharp);
  EXPECT_THAT(prism.lines, SizeIs(48));
  EXPECT_THAT(prism.facet_edges, IsEmpty());
}

TEST(ObjectModelTest, LineElementsReplaceEdgesButNotContours) {
  const ObjectModel painted = MustParse(absl::StrCat(Prism(16), "l 1 2\n"));
  EXPECT_THAT(painted.lines, SizeIs(1));
  EXPECT_THAT(painted.curves, IsEmpty());
  EXPECT_FALSE(painted.surface.empty());
  EXPECT_TRUE(MustParse(absl::StrCat(Cube(), "l 5 7\n")).surface.empty());
}

TEST(ObjectModelTest, DiameterOfManyPointsIsWithinOnePercent) {
  const ObjectModel model = MustParse(absl::StrCat(Sphere(60, 120), "l 2 50\n"));
  EXPECT_GT(model.vertices.size(), 2048u);
  EXPECT_GT(model.diameter_m, 2.0 * 0.99);
  EXPECT_LT(model.diameter_m, 2.0 * (1 + 1e-6));
}

TEST(ObjectModelTest, EdgeOfThreeFacesHasAllTheirNormals) {
  const ObjectModel model = MustParse("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nf 1 2 3\nf 2 1 4\nf 1 2 5\n");
  size_t most = 0;
  for (const ModelLine& line : model.lines) most = std::max(most, line.face_normals.size());
  EXPECT_THAT(model.lines, SizeIs(6));  // two of the boundary's edges continue each other
  EXPECT_EQ(most, 2u);                  // two of the three lie in one plane
}

TEST(ObjectModelTest, SheetWithTwoSides) {
  const ObjectModel model = MustParse("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\nf 1 3 2\nf 1 4 3\n");
  EXPECT_THAT(model.triangles, SizeIs(4));
  ASSERT_THAT(model.lines, SizeIs(4));
  for (const ModelLine& line : model.lines) EXPECT_THAT(line.face_normals, SizeIs(2));
}

TEST(ObjectModelTest, EdgesAtAGapBetweenFlushPartsAreLeftOut) {
  // Relative indices: the faces of the second cube are those of the latest vertices.
  const std::string faces =
      "f -8 -5 -6 -7\nf -4 -3 -2 -1\nf -8 -7 -3 -4\nf -7 -6 -2 -3\nf -6 -5 -1 -2\nf -5 -8 -4 -1\n";
  const std::string second = absl::StrReplaceAll(kCubeVertices, {{"v 1", "v 2"}, {"v 0", "v 1.001"}});
  const ObjectModel model = MustParse(absl::StrCat(kCubeVertices, faces, second, faces));
  EXPECT_THAT(model.notices,
              Contains("8 edges of the mesh at gaps of less than 3.674 mm between flush parts left out: such lines "
                       "are too narrow to be seen"));
  EXPECT_THAT(model.lines, SizeIs(16));
}

TEST(ObjectModelTest, WindingIsMadeConsistentAndOutward) {
  const ObjectModel inside_out =
      MustParse(absl::StrCat(kCubeVertices, "f 2 3 4 1\nf 8 7 6 5\nf 5 6 2 1\nf 6 7 3 2\nf 7 8 4 3\nf 8 5 1 4\n"));
  ExpectIsUnitCube(inside_out);
  EXPECT_THAT(inside_out.notices, Contains(HasSubstr("12 triangles turned")));
  ExpectIsUnitCube(MustParse(absl::StrReplaceAll(Cube(), {{"f 1 2 6 5", "f 5 6 2 1"}, {"f 4 1 5 8", "f 8 5 1 4"}})));
}

TEST(ObjectModelTest, WindingOfAnOpenSurfaceIsThatOfMostTriangles) {
  const std::string open = absl::StrReplaceAll(Cube(), {{"f 1 4 3 2\n", ""}});
  const ObjectModel model = MustParse(absl::StrReplaceAll(open, {{"f 1 2 6 5", "f 5 6 2 1"}}));
  EXPECT_THAT(model.notices, Contains(HasSubstr("2 triangles turned")));
  for (const ModelLine& line : model.lines) {
    for (const Eigen::Vector3d& normal : line.face_normals) {
      EXPECT_GT(normal.dot(0.5 * (line.p1 + line.p2) - Eigen::Vector3d(0.5, 0.5, 0.5)), 0.4);
    }
  }
}

TEST(ObjectModelTest, MoebiusStripStaysAsItIs) {
  std::string obj;
  constexpr int kSteps = 30;
  for (int i = 0; i < kSteps; ++i) {
    const double angle = 2 * M_PI * i / kSteps;
    for (const double side : {-0.3, 0.3}) {
      const double radius = 1 + side * std::cos(angle / 2);
      absl::StrAppendFormat(&obj, "v %.9g %.9g %.9g\n", radius * std::cos(angle), radius * std::sin(angle),
                            side * std::sin(angle / 2));
    }
  }
  for (int i = 0; i < kSteps; ++i) {
    const int a = 2 * i + 1, b = 2 * i + 2;
    const int c = i + 1 < kSteps ? a + 2 : 2, d = i + 1 < kSteps ? b + 2 : 1;
    absl::StrAppendFormat(&obj, "f %d %d %d\nf %d %d %d\n", a, c, b, b, c, d);
  }
  const ObjectModel model = MustParse(obj);
  EXPECT_THAT(model.triangles, SizeIs(2 * kSteps));
  EXPECT_THAT(model.notices, ElementsAre(HasSubstr("its winding stays as it is"),
                                         HasSubstr("the surface is open: it ends at 60 edges")));
}

TEST(ObjectModelTest, ConcavePolygonKeepsItsShape) {
  // An L of area 3: a fan from its first corner would extend beyond it and have another area.
  const ObjectModel model = MustParse("v 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\nv 0 0 0\nf 1 2 3 4 5 6\n");
  double area = 0.0;
  for (const auto& [i, j, k] : model.triangles) {
    area += (model.vertices[j] - model.vertices[i]).cross(model.vertices[k] - model.vertices[i]).norm() / 2;
  }
  EXPECT_NEAR(area, 3.0, 1e-9);
  EXPECT_THAT(model.lines, SizeIs(6));
}

// --- Writing

TEST(ObjectModelTest, ObjRoundTrip) {
  for (const std::string& text : {Cube(), absl::StrCat(kCubeVertices, "l 1 2 3 4\n"),
                                  absl::StrCat(Cube(), "v 0.2 0.5 1\nv 0.8 0.5 1\nl 9 10\nl 5 6\n"), Grid(3, 0.3)}) {
    const ObjectModel model = MustParse(text);
    const ObjectModel back = MustParse(ObjectModelToObj(model));
    EXPECT_EQ(back.vertices, model.vertices);
    EXPECT_EQ(back.triangles, model.triangles);
    EXPECT_EQ(back.diameter_m, model.diameter_m);
    ASSERT_EQ(back.lines.size(), model.lines.size());
    for (size_t i = 0; i < model.lines.size(); ++i) {
      EXPECT_EQ(back.lines[i].p1, model.lines[i].p1);
      EXPECT_EQ(back.lines[i].p2, model.lines[i].p2);
      EXPECT_EQ(back.lines[i].face_normals.size(), model.lines[i].face_normals.size());
    }
  }
}

// --- Files

TEST(ObjectModelTest, LoadsFromDiskAndNamesThePath) {
  const std::string path = testing::TempDir() + "/evpose_object_model_test.OBJ";
  std::ofstream(path) << Cube();
  const auto model = LoadObjectModel(path);
  ASSERT_TRUE(model.ok()) << model.status();
  ExpectIsUnitCube(*model);
  std::ofstream(path) << "v 0 0 nan\n";
  EXPECT_EQ(LoadObjectModel(path).status().message(), path + ": line 1: 'nan' is not a finite coordinate");
  ModelOptions options;
  options.max_bytes = 5;
  EXPECT_THAT(std::string(LoadObjectModel(path, options).status().message()),
              HasSubstr(path + ": is larger than 5 bytes"));
  std::filesystem::remove(path);
  EXPECT_EQ(LoadObjectModel(path).status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(LoadObjectModel(path).status().message()), HasSubstr(path));

  const std::string directory = testing::TempDir() + "/evpose_object_model_test_directory.obj";
  std::filesystem::create_directory(directory);
  EXPECT_EQ(LoadObjectModel(directory).status().code(), absl::StatusCode::kInvalidArgument);
  std::filesystem::remove(directory);
}

TEST(ObjectModelTest, FormatFromPath) {
  EXPECT_EQ(*ModelFormatFromPath("a/b.obj"), ModelFormat::kObj);
  EXPECT_EQ(*ModelFormatFromPath("b.PLY"), ModelFormat::kPly);
  EXPECT_EQ(*ModelFormatFromPath("./b.x.Stl"), ModelFormat::kStl);
  for (const char* path : {"a.step", "obj", "a.obj/b", ""}) {
    EXPECT_EQ(ModelFormatFromPath(path).status().code(), absl::StatusCode::kInvalidArgument) << path;
  }
}

}  // namespace
}  // namespace evpose
