// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <random>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/models/cube_files_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

TEST(BadModelTest, EmptyModels) {
  EXPECT_THAT(ErrorOf(""), HasSubstr("empty"));
  EXPECT_THAT(ErrorOf("hello world\n"), HasSubstr("no line and no face"));
  EXPECT_THAT(ErrorOf(kCubeVertices), HasSubstr("the OBJ file has 8 vertices (v) but no face (f) and no line element"));
  EXPECT_THAT(ErrorOf("v 0 0 0\nv 1 0 0\nl 1 1\nl 2 2\n"), HasSubstr("length zero"));
  EXPECT_THAT(ErrorOf("v 1 1 1\nv 1 1 1\nl 1 2\n"), HasSubstr("size is 0 m"));
  EXPECT_THAT(ErrorOf("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"), HasSubstr("no line"));
  EXPECT_THAT(ErrorOf("solid a\nendsolid a\n", ModelFormat::kStl), HasSubstr("no line and no face"));
  EXPECT_THAT(ErrorOf("v 1000001 0 0\nv 1000002 0 0\nl 1 2\n"), HasSubstr("from its origin"));
}

// Random triangles, as OBJ.
std::string TriangleSoup(int count) {
  std::mt19937 random(1);
  std::string text;
  for (int i = 0; i < 3 * count; ++i) {
    absl::StrAppend(&text, "v ", random() % 1000000, " ", random() % 1000000, " ", random() % 1000000, "\n");
  }
  for (int i = 0; i < count; ++i) absl::StrAppend(&text, "f ", 3 * i + 1, " ", 3 * i + 2, " ", 3 * i + 3, "\n");
  return text;
}

TEST(BadModelTest, ManyTrianglesWithoutNeighboursAreRefusedByTheRepair) {
  EXPECT_TRUE(Parse(TriangleSoup(1000), ModelFormat::kObj, {.metres_per_unit = 1e-6}).ok());
  const auto model = Parse(TriangleSoup(320'000), ModelFormat::kObj, {.metres_per_unit = 1e-6});
  EXPECT_THAT(std::string(model.status().message()),
              HasSubstr("repairing the mesh: its 320000 triangles are 320000 separate surfaces"));
  EXPECT_EQ(model.status().code(), absl::StatusCode::kInvalidArgument);
}

struct BadModel {
  ModelFormat format;
  const char* text;
  const char* says;
};

class MalformedModelTest : public ::testing::TestWithParam<BadModel> {};

TEST_P(MalformedModelTest, ErrorNamesThePosition) {
  EXPECT_THAT(ErrorOf(GetParam().text, GetParam().format), HasSubstr(GetParam().says)) << GetParam().text;
}

#define EVPOSE_PLY_TOP "ply\nformat ascii 1.0\nelement vertex 3\n"
#define EVPOSE_PLY_XYZ "property float x\nproperty float y\nproperty float z\n"
#define EVPOSE_PLY_FACE "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
#define EVPOSE_PLY EVPOSE_PLY_TOP EVPOSE_PLY_XYZ EVPOSE_PLY_FACE
#define EVPOSE_STL \
  "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\n"

INSTANTIATE_TEST_SUITE_P(
    Obj, MalformedModelTest,
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
        BadModel{ModelFormat::kObj, "v 0 0 0\nv 1 0 0\nf\n", "line 3: a face has no corners"},
        BadModel{ModelFormat::kObj, "v 0 0 0\nv 1 0 0\nf 1 2 /3\n", "line 3: '/3' is not a vertex index"}));

INSTANTIATE_TEST_SUITE_P(
    Ply, MalformedModelTest,
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
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "element edge 1\nend_header\n",
                 "element edge: has no property"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "element tristrips 1\nend_header\n",
                 "element tristrips: triangle strips are not read; export the model as faces"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "element vertex 1\n" EVPOSE_PLY_XYZ "end_header\n",
                 "element vertex: only one is read"},
        BadModel{ModelFormat::kPly, "ply\nformat ascii 1.0\n" EVPOSE_PLY_FACE, "element face: must follow"},
        BadModel{ModelFormat::kPly,
                 EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "element face 1\nproperty list uchar int vertex_index\n" EVPOSE_PLY_FACE,
                 "element face: only one is read"},
        BadModel{ModelFormat::kPly,
                 EVPOSE_PLY_TOP EVPOSE_PLY_XYZ
                 "element edge 3\nproperty int vertex1\nend_header\n0 0 0\n1 0 0\n1 1 0\n1\n",
                 "the file ends before"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "element face 1\nproperty int a\nend_header\n",
                 "needs the list vertex_indices"},
        BadModel{ModelFormat::kPly,
                 EVPOSE_PLY_TOP EVPOSE_PLY_XYZ "element face 1\nproperty list uchar float vertex_index\nend_header\n",
                 "needs the list vertex_indices, of integers"},
        BadModel{ModelFormat::kPly,
                 EVPOSE_PLY_TOP EVPOSE_PLY_XYZ
                 "element face 1\nproperty list uchar int vertex_index\nproperty list uchar int vertex_indices\n"
                 "end_header\n",
                 "exactly once"},
        BadModel{ModelFormat::kPly, "ply\nformat ascii 1.0\nend_header\n", "element vertex: missing"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n", "the file ends before"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1\n3 0 1 2\n", "line 12: fewer numbers"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0 4\n3 0 1 2\n", "line 12: more numbers"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n3 0 1 3\n", "line 13: vertex index 3"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n3 0 1 -1\n", "line 13: vertex index -1"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n-3 0 1 2\n", "line 13: a list of negative length"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n0\n", "line 13: a face has no corners"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n+3 0 1 2\n",
                 "line 13: '+3' is not a whole number"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n3 0 +1 2\n",
                 "line 13: '+1' is not a whole number"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 nan 0\n1 1 0\n3 0 1 2\n", "line 11: y is not a finite"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 a 0\n1 1 0\n3 0 1 2\n", "line 11: 'a' is not a number"},
        BadModel{ModelFormat::kPly, EVPOSE_PLY "0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n3 0 1 2\n", "line 14: more lines"}));

INSTANTIATE_TEST_SUITE_P(
    Stl, MalformedModelTest,
    ::testing::Values(BadModel{ModelFormat::kStl, "v 0 0 0\n", "not an STL file"},
                      BadModel{ModelFormat::kStl, EVPOSE_STL, "ends without 'endsolid'"},
                      BadModel{ModelFormat::kStl, EVPOSE_STL "endsolid\nfacet\n", "line 10: STL: expected 'solid'"},
                      BadModel{ModelFormat::kStl, EVPOSE_STL "vertex 0 0 0\n", "line 9: STL: expected 'facet normal'"},
                      BadModel{ModelFormat::kStl, "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0\n",
                               "line 4: STL: expected 'vertex' and 3 numbers"},
                      BadModel{ModelFormat::kStl, "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 nan\n",
                               "line 4: 'nan' is not a finite coordinate"}));

TEST(BadModelTest, IncompleteBinaryStl) {
  for (const char* header : {"solid of an exporter", "another"}) {
    std::string stl = header;
    stl.resize(80, ' ');
    stl += std::string("\x03\0\0\0", 4) + std::string(120, '\0');
    EXPECT_THAT(ErrorOf(stl, ModelFormat::kStl),
                HasSubstr("the header states 3 facets, which take 234 bytes, but the file has 204"));
  }
}

// The binary STL with a coordinate of one facet that is not a number.
std::string WithNan(std::string stl, size_t facet) {
  const float nan = std::nanf("");
  std::memcpy(stl.data() + 84 + facet * 50 + 12 + 8, &nan, 4);
  return stl;
}

TEST(BadModelTest, AFewFacetsOfABinaryStlMayNotBeFinite) {
  const std::string small = BinaryStl(MustParse(Cube()));
  EXPECT_THAT(ErrorOf(WithNan(small, 3), ModelFormat::kStl),
              HasSubstr("1 facet with a coordinate that is not a finite number, the first one facet 4 of 12: the file "
                        "is damaged; export it again"));
  const ObjectModel prism = MustParse(Prism(40));
  const std::string large = BinaryStl(prism);
  const ObjectModel model = MustParse(WithNan(large, 155), ModelFormat::kStl);
  EXPECT_EQ(model.triangles.size(), prism.triangles.size() - 1);
  EXPECT_THAT(model.notices, ::testing::Contains("1 facet with a coordinate that is not a finite number dropped, the "
                                                 "first one facet 156"));
  EXPECT_THAT(ErrorOf(WithNan(WithNan(large, 9), 8), ModelFormat::kStl), HasSubstr("2 facets"));
}

TEST(BadModelTest, ByteOrderMarksAreSkippedOrNamed) {
  const ObjectModel cube = MustParse(Cube());
  for (const auto& [format, text] : {std::pair(ModelFormat::kObj, Cube()), std::pair(ModelFormat::kPly, AsciiPly()),
                                     std::pair(ModelFormat::kStl, AsciiStl(cube))}) {
    const ObjectModel expected = MustParse(text, format), model = MustParse("\xEF\xBB\xBF" + text, format);
    EXPECT_EQ(model.vertices, expected.vertices);
    EXPECT_EQ(model.triangles, expected.triangles);
    for (const char* mark : {"\xFF\xFE", "\xFE\xFF"}) {
      EXPECT_EQ(ErrorOf(mark + text, format), "the text is in UTF-16 or UTF-32; save the file as UTF-8 or ASCII");
    }
  }
  EXPECT_THAT(MustParse("\xEF\xBB\xBF" + BinaryPly(true), ModelFormat::kPly).triangles, ::testing::SizeIs(12));
  std::string binary = BinaryStl(cube);  // the first bytes are free text
  binary.replace(0, 2, "\xFF\xFE");
  EXPECT_THAT(MustParse(binary, ModelFormat::kStl).triangles, ::testing::SizeIs(12));
}

TEST(BadModelTest, OtherElementsOfAPlyAreSkipped) {
  const std::string header =
      "element edge 2\nproperty int vertex1\nproperty int vertex2\n"
      "element material 1\nproperty list uchar float k\nend_header\n";
  std::string text = AsciiPly();
  text.replace(text.find("end_header\n"), 11, header);
  const ObjectModel model = MustParse(text + "0 1\n1 2\n2 0.5 0.25\n", ModelFormat::kPly);
  EXPECT_EQ(model.triangles, MustParse(AsciiPly(), ModelFormat::kPly).triangles);
  EXPECT_THAT(model.notices,
              ::testing::ElementsAre("2 PLY elements other than vertex and face not used: edge and others"));
  for (const bool big_endian : {false, true}) {
    std::string binary = BinaryPly(big_endian);
    binary.replace(binary.find("end_header\n"), 11, header);
    for (const int32_t end : {0, 1, 1, 2}) AppendBinary(end, big_endian, binary);
    binary += '\2';
    for (const float k : {0.5f, 0.25f}) AppendBinary(k, big_endian, binary);
    EXPECT_THAT(MustParse(binary, ModelFormat::kPly).triangles, ::testing::SizeIs(12));
    EXPECT_THAT(ErrorOf(binary.substr(0, binary.size() - 1), ModelFormat::kPly), HasSubstr("the file ends before"));
  }
}

TEST(BadModelTest, WhatIsProbablyNotMeantIsNoticed) {
  const auto notices = [](const std::string& text) { return MustParse(text).notices; };
  const auto names = [](const char* what) { return ::testing::Contains(HasSubstr(what)); };
  EXPECT_THAT(notices(absl::StrCat(Cube(), "l 1 2\n")),
              names("the line elements (l) of the file, 1 m in all, are taken as all edges of the object: those of its "
                    "faces, 12 m in all, are not used; remove the line elements"));
  const ObjectModel whole = MustParse(Cube());
  EXPECT_THAT(notices(ObjectModelToObj(whole)), ::testing::IsEmpty()) << "its line elements are all edges";
  const std::string open = Cube().substr(0, Cube().rfind("f "));
  EXPECT_THAT(notices(open), names("the surface is open: it ends at 4 edges of the mesh, which count as visible edges; "
                                   "if the object is solid, export it as a closed body"));
  EXPECT_THAT(notices("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"), ::testing::IsEmpty()) << "a sheet";
  EXPECT_THAT(notices("v 0 2 0\nv 3 2 0\nv 3 1 0\nv 2 0 0\nv 2 4 0\nv 0 0 5\nf 1 2 3 4 5\nf 1 2 6\n"),
              names("1 polygon not read completely, because the outline crosses itself"));
}

TEST(BadModelTest, Limits) {
  ModelOptions options;
  options.max_bytes = 50;
  EXPECT_THAT(ErrorOf(Cube(), ModelFormat::kObj, options), HasSubstr("more than the limit of 50"));
  options = {};
  options.max_triangles = 11;
  EXPECT_THAT(ErrorOf(Cube(), ModelFormat::kObj, options), HasSubstr("line 14: more than 11 triangles"));
  EXPECT_THAT(ErrorOf(AsciiPly(), ModelFormat::kPly, options), HasSubstr("more than 11 triangles"));
  EXPECT_THAT(ErrorOf(BinaryStl(MustParse(Cube())), ModelFormat::kStl, options), HasSubstr("more than 11 triangles"));
  options.max_triangles = 2;
  EXPECT_THAT(ErrorOf(absl::StrCat(kCubeVertices, "l 1 2 3 4\n"), ModelFormat::kObj, options),
              HasSubstr("line 9: more than 2 triangles and line elements"));
  std::string polygon = "f";
  for (int i = 0; i < 600; ++i) polygon += " 1";
  EXPECT_THAT(ErrorOf(absl::StrCat(kCubeVertices, polygon)), HasSubstr("line 9: a face has 600 corners"));
}

TEST(BadModelTest, OptionsNameTheWrongField) {
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
  options.max_triangles = size_t{1} << 60;
  EXPECT_THAT(message(options), HasSubstr("max_triangles"));
}

TEST(BadModelTest, SizesThatOnlyAWrongUnitExplains) {
  ModelOptions options;
  for (const double metres_per_unit : {1e-150, 1e-7, 1e4, 1e150}) {
    options.metres_per_unit = metres_per_unit;
    EXPECT_THAT(ErrorOf(Cube(), ModelFormat::kObj, options),
                HasSubstr("models of 1 micrometres to 10 km are accepted: check its unit"));
  }
  for (const double metres_per_unit : {1e-5, 1e3}) {
    options.metres_per_unit = metres_per_unit;
    EXPECT_TRUE(Parse(Cube(), ModelFormat::kObj, options).ok()) << metres_per_unit;
  }
}

TEST(BadModelTest, EveryTruncationIsAnErrorOrAWholeModel) {
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
      // A model may lack the line feed, or the last digits or letters of its last word.
      EXPECT_TRUE(!model.ok() || length + 8 >= text.size()) << text.substr(0, length);
    }
  }
}

TEST(BadModelTest, DamagedFilesDoNotCrash) {
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

TEST(BadModelTest, AFormatOfTheApiIsNotParsed) {
  EXPECT_EQ(Parse(EVPOSE_STL "endsolid a\n", ModelFormat::kMesh).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(BadModelTest, PointsWithoutAFaceAreNoPartOfTheObject) {
  const std::string faces = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n";
  const auto ply = [](int vertices, const std::string& body) {
    return absl::StrCat("ply\nformat ascii 1.0\nelement vertex ", vertices, "\n" EVPOSE_PLY_XYZ,
                        "element face 4\nproperty list uchar int vertex_indices\nend_header\n", body);
  };
  const auto expected = Parse(ply(4, faces), ModelFormat::kPly);
  const std::string shifted = "100 0 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 1 3 2\n3 1 2 4\n3 2 3 4\n3 3 1 4\n";
  const auto model = Parse(ply(5, shifted), ModelFormat::kPly);
  ASSERT_TRUE(expected.ok() && model.ok()) << model.status();
  EXPECT_EQ(model->diameter_m, expected->diameter_m);
  EXPECT_EQ(model->vertices, expected->vertices);
  EXPECT_EQ(model->triangles, expected->triangles);
  EXPECT_THAT(model->notices, ::testing::Contains("1 point that no face or line uses dropped"));
  EXPECT_THAT(model->notices, ::testing::Not(::testing::Contains(HasSubstr("largest side"))));
}

TEST(BadModelTest, GarbageDoesNotCrash) {
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

}  // namespace
}  // namespace evpose
