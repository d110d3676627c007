#include "core/models/object_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <random>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"

namespace evpose {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr char kCubeVertices[] =
    "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
    "v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n";
constexpr char kCubeFaces[] = "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

std::string Cube() { return absl::StrCat(kCubeVertices, kCubeFaces); }

absl::StatusOr<ObjectModel> Parse(const std::string& text, ModelFormat format = ModelFormat::kObj,
                                  const ModelOptions& options = {}) {
  return ParseObjectModel({reinterpret_cast<const uint8_t*>(text.data()), text.size()}, format, options);
}

ObjectModel MustParse(const std::string& text, ModelFormat format = ModelFormat::kObj,
                      const ModelOptions& options = {}) {
  absl::StatusOr<ObjectModel> model = Parse(text, format, options);
  EXPECT_TRUE(model.ok()) << model.status();
  return model.ok() ? *std::move(model) : ObjectModel();
}

std::string ErrorOf(const std::string& text, ModelFormat format = ModelFormat::kObj, const ModelOptions& options = {}) {
  const absl::StatusOr<ObjectModel> model = Parse(text, format, options);
  EXPECT_EQ(model.status().code(), absl::StatusCode::kInvalidArgument);
  return std::string(model.status().message());
}

double SignedVolume(const ObjectModel& model) {
  double volume = 0.0;
  for (const auto& [i, j, k] : model.triangles) {
    volume += model.vertices[i].dot(model.vertices[j].cross(model.vertices[k])) / 6.0;
  }
  return volume;
}

// The lines' ends as a set, independent of order and direction.
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

std::string AsciiPly() {
  return "ply\nformat ascii 1.0\ncomment a cube\nelement vertex 8\nproperty float x\nproperty float y\n"
         "property double z\nproperty uchar red\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
         "0 0 0 1\n1 0 0 1\n1 1 0 1\n0 1 0 1\n0 0 1 1\n1 0 1 1\n1 1 1 1\n0 1 1 1\n"
         "4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n";
}

template <typename T>
void AppendBinary(T value, bool big_endian, std::string& out) {
  char raw[sizeof(T)];
  std::memcpy(raw, &value, sizeof(T));
  if (big_endian) std::reverse(raw, raw + sizeof(T));
  out.append(raw, sizeof(T));
}

std::string BinaryPly(bool big_endian) {
  const ObjectModel cube = MustParse(Cube());
  std::string ply = absl::StrCat("ply\nformat binary_", big_endian ? "big" : "little",
                                 "_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
                                 "property float z\nelement face 12\nproperty list uchar uint vertex_index\n"
                                 "end_header\n");
  for (const Eigen::Vector3d& v : cube.vertices) {
    for (int i = 0; i < 3; ++i) AppendBinary(static_cast<float>(v[i]), big_endian, ply);
  }
  for (const auto& triangle : cube.triangles) {
    ply += '\3';
    for (const uint32_t vertex : triangle) AppendBinary(vertex, big_endian, ply);
  }
  return ply;
}

std::string AsciiStl(const ObjectModel& model) {
  std::string stl = "solid a cube\n";
  for (const auto& triangle : model.triangles) {
    stl += "  facet normal 0 0 0\n    outer loop\n";
    for (const uint32_t vertex : triangle) {
      const Eigen::Vector3d& v = model.vertices[vertex];
      absl::StrAppendFormat(&stl, "      vertex %g %g %g\n", v.x(), v.y(), v.z());
    }
    stl += "    endloop\n  endfacet\n";
  }
  return stl + "endsolid a cube\n";
}

std::string BinaryStl(const ObjectModel& model) {
  std::string stl(80, ' ');
  AppendBinary(static_cast<uint32_t>(model.triangles.size()), false, stl);
  for (const auto& triangle : model.triangles) {
    stl.append(12, '\0');
    for (const uint32_t vertex : triangle) {
      for (int i = 0; i < 3; ++i) AppendBinary(static_cast<float>(model.vertices[vertex][i]), false, stl);
    }
    stl.append(2, '\0');
  }
  return stl;
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

TEST(ObjectModelTest, StlCornersThatDifferByARoundingAreWelded) {
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
  // A pipe without a writer: opening it would wait for ever.
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
  EXPECT_THAT(model.notices, IsEmpty());
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
  const std::string plate = absl::StrReplaceAll(Cube(), {{" 1\n", " 0.0005\n"}, {"f 4 1 5 8", "f 4 1 5 8"}});
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
  EXPECT_THAT(model.notices, Contains("2 lines dropped that stand there twice"));
}

TEST(ObjectModelTest, SheetHasItsBoundary) {
  const ObjectModel model = MustParse("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n");
  ASSERT_THAT(model.lines, SizeIs(4));
  for (const ModelLine& line : model.lines) {
    ASSERT_THAT(line.face_normals, SizeIs(1));
    EXPECT_NEAR(line.face_normals[0].z(), 1.0, 1e-12);
  }
}

// An n x n grid of quads on z = 0, and `fold` more rows that go up at the end.
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

TEST(ObjectModelTest, CurvedEdgesAreNotJoined) {
  // A disc of many corners, cut into triangles: its rim may lose no corner that stands out.
  constexpr int kCorners = 360;
  std::string obj = "v 0 0 0\n";
  for (int i = 0; i < kCorners; ++i) {
    const double angle = 2 * M_PI * i / kCorners;
    absl::StrAppendFormat(&obj, "v %.9g %.9g 0\n", std::cos(angle), std::sin(angle));
  }
  for (int i = 0; i < kCorners; ++i) absl::StrAppendFormat(&obj, "f 1 %d %d\n", i + 2, (i + 1) % kCorners + 2);
  EXPECT_THAT(MustParse(obj).lines, SizeIs(kCorners));
}

TEST(ObjectModelTest, RingOfEdgesThatHardlyTurnIsCutNotJoinedToAPoint) {
  constexpr int kCorners = 5000;
  std::string obj = "v 0 0 0\n";
  for (int i = 0; i < kCorners; ++i) {
    const double angle = 2 * M_PI * i / kCorners;
    absl::StrAppendFormat(&obj, "v %.9g %.9g 0\n", std::cos(angle), std::sin(angle));
  }
  for (int i = 0; i < kCorners; ++i) absl::StrAppendFormat(&obj, "f 1 %d %d\n", i + 2, (i + 1) % kCorners + 2);
  const ObjectModel model = MustParse(obj);
  double length = 0.0;
  for (const ModelLine& line : model.lines) {
    length += (line.p2 - line.p1).norm();
    EXPECT_GT((0.5 * (line.p1 + line.p2)).norm(), 1.0 - 1e-4);
  }
  EXPECT_NEAR(length, 2 * M_PI, 1e-3);
  EXPECT_LT(model.lines.size(), 1000u);
}

std::string Prism(int sides) {
  std::string obj, low, high, walls;
  for (int i = 0; i < sides; ++i) {
    const double angle = 2 * M_PI * i / sides;
    absl::StrAppendFormat(&obj, "v %.9g %.9g 0\nv %.9g %.9g 1\n", std::cos(angle), std::sin(angle), std::cos(angle),
                          std::sin(angle));
    const int a = 2 * i + 1, b = 2 * ((i + 1) % sides) + 1;
    low = absl::StrCat(" ", a, low);
    absl::StrAppend(&high, " ", a + 1);
    absl::StrAppendFormat(&walls, "f %d %d %d %d\n", a, b, b + 1, a + 1);
  }
  return absl::StrCat(obj, "f", low, "\nf", high, "\n", walls);
}

TEST(ObjectModelTest, CreaseAngle) {
  // 8 sides turn by 45 degrees, 16 by 22.5.
  EXPECT_THAT(MustParse(Prism(8)).lines, SizeIs(24));
  EXPECT_THAT(MustParse(Prism(16)).lines, SizeIs(32));
  ModelOptions options;
  options.crease_angle_deg = 20.0;
  EXPECT_THAT(MustParse(Prism(16), ModelFormat::kObj, options).lines, SizeIs(48));
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

TEST(ObjectModelTest, SmoothModelHasNoLine) {
  EXPECT_THAT(ErrorOf(Sphere(24, 48)), HasSubstr("no line: no edge turns by more than 30 degrees"));
  const ObjectModel painted = MustParse(absl::StrCat(Sphere(24, 48), "l 2 50\n"));
  EXPECT_THAT(painted.lines, SizeIs(1));
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
  EXPECT_THAT(model.notices, IsEmpty());
}

TEST(ObjectModelTest, ConcavePolygonKeepsItsShape) {
  // An L of area 3: a fan from its first corner would cover 4 somewhere and leave it.
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

// --- Bad input

TEST(ObjectModelTest, EmptyModels) {
  EXPECT_THAT(ErrorOf(""), HasSubstr("empty"));
  EXPECT_THAT(ErrorOf("hello world\n"), HasSubstr("no line and no face"));
  EXPECT_THAT(ErrorOf(kCubeVertices), HasSubstr("no line and no face"));
  EXPECT_THAT(ErrorOf("v 0 0 0\nv 1 0 0\nl 1 1\nl 2 2\n"), HasSubstr("length zero"));
  EXPECT_THAT(ErrorOf("v 1 1 1\nv 1 1 1\nl 1 2\n"), HasSubstr("size is 0 m"));
  EXPECT_THAT(ErrorOf("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"), HasSubstr("no line"));
  EXPECT_THAT(ErrorOf("solid a\nendsolid a\n", ModelFormat::kStl), HasSubstr("no line and no face"));
  EXPECT_THAT(ErrorOf("v 1000001 0 0\nv 1000002 0 0\nl 1 2\n"), HasSubstr("from its origin"));
}

struct BadModel {
  ModelFormat format;
  const char* text;
  const char* says;
};

class BadModelTest : public ::testing::TestWithParam<BadModel> {};

TEST_P(BadModelTest, SaysWhere) {
  EXPECT_THAT(ErrorOf(GetParam().text, GetParam().format), HasSubstr(GetParam().says)) << GetParam().text;
}

#define EVPOSE_PLY_TOP "ply\nformat ascii 1.0\nelement vertex 3\n"
#define EVPOSE_PLY_XYZ "property float x\nproperty float y\nproperty float z\n"
#define EVPOSE_PLY_FACE "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
#define EVPOSE_PLY EVPOSE_PLY_TOP EVPOSE_PLY_XYZ EVPOSE_PLY_FACE
#define EVPOSE_STL \
  "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\n"

INSTANTIATE_TEST_SUITE_P(
    Obj, BadModelTest,
    ::testing::Values(
        BadModel{ModelFormat::kObj, "v 0 0 0\nv nan 0 0\nl 1 2\n", "line 2: 'nan' is not a finite coordinate"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nv 0 -inf 0\nl 1 2\n", "line 2: '-inf' is not a finite coordinate"},
        BadModel{ModelFormat::kObj, "v 0 0 1e40\nv 0 1 0\nl 1 2\n", "line 1: '1e40' is not a finite coordinate"},
        BadModel{ModelFormat::kObj, "v 0 0 0\n\nv 0 x 0\nl 1 2\n", "line 3: 'x' is not a number"},
        BadModel{ModelFormat::kObj, "v 0 0,5 0\nv 0 1 0\nl 1 2\n", "line 1: '0,5' is not a number"},
        BadModel{ModelFormat::kObj, "v 0 0\n", "line 1: a vertex (v) needs 3 numbers, found 2"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nv 1 0 0\nl 1 3\n", "line 3: vertex index 3, but there are 2 vertices"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nv 1 0 0\nl 1 0\n", "line 3: vertex index 0"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nl -1 -2\nv 0 0 1\n", "line 2: vertex index -2"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nl 1 99999999999999999999\n", "line 2: '99999999999999999999' is not"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nl 1 4294967297\n", "line 2: vertex index 4294967297"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nl 1\n", "line 2: a line element (l) needs 2 points"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3: a face has 2 corners"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nv 1 0 0\nf 1 2 /3\n", "line 3: '/3' is not a vertex index"}));

INSTANTIATE_TEST_SUITE_P(
    Ply, BadModelTest,
    ::testing::Values(
        BadModel{ModelFormat::kPly, "v 0 0 0\n", "line 1: not a PLY file"},
        BadModel{ModelFormat::kPly, "ply\n", "without end_header"},
        BadModel{ModelFormat::kPly, "ply\nend_header\n", "no format"},
        BadModel{ModelFormat::kPly, "ply\nformat utf8 1.0\n", "line 2: PLY header: 'format'"},
        BadModel{ModelFormat::kPly, "ply\nproperty float x\n", "line 2: PLY header: 'property'"},
        BadModel{ModelFormat::kPly, "ply\nelement vertex many\n", "line 2: 'many' is not a count"},
        BadModel{ModelFormat::kPly, "ply\nelement vertex -3\n", "line 2: '-3' is not a count"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP "property half x\n", "line 4: 'half' is not a PLY type"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP "property list float int x\n", "line 4: a list cannot be counted"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP EVPOSE_PLY_FACE, "element vertex: needs the properties x, y and z"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "property list uchar int a\nend_header\n",
                 "has a list"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "element edge 1\nend_header\n", "element edge: only"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "element face 1\nproperty int a\nend_header\n",
                 "needs the list vertex_indices"},
        BadModel{ModelFormat::kPly, "ply\nformat ascii 1.0\nend_header\n", "element vertex: missing"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n", "the file ends before"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1\n3 0 1 2\n", "line 12: fewer numbers"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0 4\n3 0 1 2\n", "line 12: more numbers"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n3 0 1 3\n", "line 13: vertex index 3"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n3 0 1 -1\n", "line 13: vertex index -1"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n-3 0 1 2\n", "line 13: a list of negative length"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n0\n", "line 13: a face has 0 corners"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 nan 0\n1 1 0\n3 0 1 2\n", "line 11: y is not a finite"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 a 0\n1 1 0\n3 0 1 2\n", "line 11: 'a' is not a number"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n3 0 1 2\n", "line 14: more lines"}));

INSTANTIATE_TEST_SUITE_P(
    Stl, BadModelTest,
    ::testing::Values(BadModel{ModelFormat::kStl, "v 0 0 0\n", "not an STL file"},
                      BadModel{ModelFormat::kStl, EVPOSE_STL, "ends without 'endsolid'"},
                      BadModel{ModelFormat::kStl, EVPOSE_STL "endsolid\nfacet\n", "line 10: STL: expected 'solid'"},
                      BadModel{ModelFormat::kStl, EVPOSE_STL "vertex 0 0 0\n", "line 9: STL: expected 'facet normal'"},
                      BadModel{ModelFormat::kStl, "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0\n",
                               "line 4: STL: expected 'vertex' and 3 numbers"},
                      BadModel{ModelFormat::kStl, "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 nan\n",
                               "line 4: 'nan' is not a finite coordinate"}));

TEST(ObjectModelTest, BinaryStlWithNan) {
  std::string stl = BinaryStl(MustParse(Cube()));
  const float nan = std::nanf("");
  std::memcpy(stl.data() + 84 + 50 * 3 + 12 + 8, &nan, 4);
  EXPECT_THAT(ErrorOf(stl, ModelFormat::kStl), HasSubstr("facet 4: a coordinate is not a finite number"));
}

TEST(ObjectModelTest, Limits) {
  ModelOptions options;
  options.max_bytes = 50;
  EXPECT_THAT(ErrorOf(Cube(), ModelFormat::kObj, options), HasSubstr("more than the limit of 50"));
  options = {};
  options.max_triangles = 11;
  EXPECT_THAT(ErrorOf(Cube(), ModelFormat::kObj, options), HasSubstr("line 14: more than 11 triangles"));
  EXPECT_THAT(ErrorOf(AsciiPly(), ModelFormat::kPly, options), HasSubstr("more than 11 triangles"));
  EXPECT_THAT(ErrorOf(BinaryStl(MustParse(Cube())), ModelFormat::kStl, options), HasSubstr("more than 11 triangles"));
  options = {};
  options.max_lines = 11;
  EXPECT_THAT(ErrorOf(Cube(), ModelFormat::kObj, options), HasSubstr("12 lines, more than the limit of 11"));
  options.max_lines = 2;
  EXPECT_THAT(ErrorOf(absl::StrCat(kCubeVertices, "l 1 2 3 4\n"), ModelFormat::kObj, options),
              HasSubstr("line 9: more than 2 lines"));
  std::string polygon = "f";
  for (int i = 0; i < 600; ++i) polygon += " 1";
  EXPECT_THAT(ErrorOf(absl::StrCat(kCubeVertices, polygon)), HasSubstr("line 9: a face has 600 corners"));
}

TEST(ObjectModelTest, OptionsNameTheWrongField) {
  const auto message = [](const ModelOptions& options) { return ErrorOf(Cube(), ModelFormat::kObj, options); };
  for (const double bad : {0.0, -1.0, std::nan(""), HUGE_VAL}) {
    ModelOptions options;
    options.metres_per_unit = bad;
    EXPECT_THAT(message(options), HasSubstr("metres_per_unit"));
    options = {};
    options.crease_angle_deg = bad;
    EXPECT_THAT(message(options), HasSubstr("crease_angle_deg"));
  }
  ModelOptions options;
  options.max_lines = size_t{1} << 60;
  EXPECT_THAT(message(options), HasSubstr("max_lines"));
  options = {};
  options.max_triangles = size_t{1} << 60;
  EXPECT_THAT(message(options), HasSubstr("max_triangles"));
}

TEST(ObjectModelTest, EveryTruncationIsAnErrorOrAWholeModel) {
  const ObjectModel cube = MustParse(Cube());
  const std::pair<ModelFormat, std::string> files[] = {{ModelFormat::kObj, absl::StrCat(Cube(), "l 1 2\nl 2 3\n")},
                                                       {ModelFormat::kPly, AsciiPly()},
                                                       {ModelFormat::kPly, BinaryPly(false)},
                                                       {ModelFormat::kStl, AsciiStl(cube)},
                                                       {ModelFormat::kStl, BinaryStl(cube)}};
  for (const auto& [format, text] : files) {
    for (size_t length = 0; length < text.size(); ++length) {
      const auto model = Parse(text.substr(0, length), format);
      if (format == ModelFormat::kObj) continue;  // a shorter OBJ may be a model; it must only not crash
      // All that may be missing is the line feed, or the last word's last digits or letters.
      EXPECT_TRUE(!model.ok() || length + 8 >= text.size()) << text.substr(0, length);
    }
  }
}

TEST(ObjectModelTest, DamagedFilesDoNotCrash) {
  const ObjectModel cube = MustParse(Cube());
  const std::pair<ModelFormat, std::string> files[] = {{ModelFormat::kObj, absl::StrCat(Cube(), "l 1 2\nl 2 3\n")},
                                                       {ModelFormat::kPly, AsciiPly()},
                                                       {ModelFormat::kPly, BinaryPly(false)},
                                                       {ModelFormat::kPly, BinaryPly(true)},
                                                       {ModelFormat::kStl, AsciiStl(cube)},
                                                       {ModelFormat::kStl, BinaryStl(cube)}};
  std::mt19937 random(3);
  int accepted = 0, refused = 0;
  for (const auto& [format, text] : files) {
    for (int trial = 0; trial < 400; ++trial) {
      std::string damaged = text;
      for (int i = 1 + random() % 4; i > 0; --i) {
        const size_t at = random() % damaged.size();
        switch (random() % 4) {
          case 0:
            damaged[at] = static_cast<char>(random());
            break;
          case 1:
            damaged[at] = "0123456789- .\n"[random() % 14];
            break;
          case 2:
            damaged.erase(at, 1 + random() % 8);
            break;
          default:
            damaged.insert(at, damaged.substr(random() % damaged.size(), random() % 20));
        }
        if (damaged.empty()) damaged = " ";
      }
      const auto model = Parse(damaged, format);
      (model.ok() ? accepted : refused) += 1;
      if (!model.ok()) {
        EXPECT_EQ(model.status().code(), absl::StatusCode::kInvalidArgument);
        continue;
      }
      for (const auto& triangle : model->triangles) {
        for (const uint32_t vertex : triangle) ASSERT_LT(vertex, model->vertices.size());
      }
      for (const ModelLine& line : model->lines) ASSERT_TRUE(line.p1.allFinite() && line.p2.allFinite());
      ASSERT_GT(model->diameter_m, 0.0);
    }
  }
  EXPECT_GT(accepted, 100);
  EXPECT_GT(refused, 100);
}

TEST(ObjectModelTest, GarbageDoesNotCrash) {
  std::mt19937 random(4);
  for (const ModelFormat format : {ModelFormat::kObj, ModelFormat::kPly, ModelFormat::kStl}) {
    for (int trial = 0; trial < 200; ++trial) {
      std::string bytes(random() % 2000, '\0');
      for (char& byte : bytes) byte = static_cast<char>(random());
      if (trial % 2 == 0 && format == ModelFormat::kPly) bytes = absl::StrCat("ply\n", bytes);
      if (trial % 2 == 0 && format == ModelFormat::kStl) bytes = absl::StrCat("solid ", bytes);
      EXPECT_FALSE(Parse(bytes, format).ok());
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
              HasSubstr(path + ": the model has 10 bytes"));
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
