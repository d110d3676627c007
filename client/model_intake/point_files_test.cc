// SPDX-License-Identifier: Apache-2.0

// Files that contain points without faces: what is left out is noticed, and a file of points alone is refused.
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/model_intake/model_intake.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using nlohmann::json;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

constexpr const char* kRemedy =
    "a cloud of points has no surface; export the faces of the object, or compute a mesh from the points";

absl::StatusOr<ObjectModel> Load(const std::string& name, const std::string& contents) {
  const TemporaryDirectory directory;
  EXPECT_TRUE(WriteFile(directory.File(name), contents).ok());
  return LoadModelFile(directory.File(name));
}

std::string ErrorOf(const std::string& name, const std::string& contents) {
  return std::string(Load(name, contents).status().message());
}

// A box with a further primitive of this mode that has its 24 points; without triangles, this primitive is the only
// one.
json BoxWithPrimitive(int mode, bool has_triangles) {
  json document = json::parse(ReadFile(FindTestData("models/label_box.gltf"), 1u << 20).value());
  document["meshes"][0]["primitives"].push_back({{"attributes", {{"POSITION", 0}}}, {"mode", mode}});
  if (!has_triangles) {
    document["meshes"][0]["primitives"].erase(0);
    document["meshes"][0]["primitives"].erase(0);
  }
  return document;
}

TEST(PointFilesTest, PointsBesideTrianglesOfAGltfAreNoticed) {
  const auto model = Load("box.gltf", BoxWithPrimitive(0, true).dump());
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_THAT(model->notices, Contains("24 point elements of the file not used: single points have no visible edges"));
  EXPECT_EQ(model->triangles.size(), 12u);
}

TEST(PointFilesTest, LinesBesideTrianglesOfAGltfAreEdgesWithANotice) {
  const auto model = Load("box.gltf", BoxWithPrimitive(1, true).dump());
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_THAT(model->notices, Contains(HasSubstr("lines of the file taken as visible edges that are drawn on the")));
  EXPECT_THAT(model->notices, Not(Contains(HasSubstr("point element"))));
}

TEST(PointFilesTest, AFileOfPointsAloneIsRefusedWithTheRemedy) {
  EXPECT_THAT(ErrorOf("box.gltf", BoxWithPrimitive(0, false).dump()),
              HasSubstr(absl::StrCat("box.gltf: has 24 points, but no triangle and no line: ", kRemedy)));
  EXPECT_THAT(ErrorOf("box.off", "OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n"),
              HasSubstr(absl::StrCat("box.off: states 3 points and no face: ", kRemedy)));
  EXPECT_THAT(
      ErrorOf("box.obj", "v 0 0 0\nv 1 0 0\np 1 2\n"),
      HasSubstr("it is incomplete, or a cloud of points, which has no surface; export the faces of the object, or"));
  const std::string ply =
      "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n";
  EXPECT_THAT(ErrorOf("box.ply", ply + "end_header\n0 0 0\n1 0 0\n"),
              HasSubstr(absl::StrCat("box.ply: the model file has 2 points, but no line and no face: ", kRemedy)));
  const std::string edges = "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n";
  EXPECT_THAT(ErrorOf("box.ply", ply + edges + "0 0 0\n1 0 0\n0 1\n"),
              HasSubstr(absl::StrCat(kRemedy, " (1 PLY element other than vertex and face not used: edge)")));
}

TEST(PointFilesTest, FacesOfOneCornerAndStatementsOfPointsAreNoticed) {
  const std::string cube = "4 6 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n1 0\n1 3\n";
  const auto off = Load("box.off", "OFF\n" + cube);
  ASSERT_TRUE(off.ok()) << off.status();
  EXPECT_THAT(off->notices, Contains("2 point elements of the file not used: single points have no visible edges"));
  const auto obj = Load("box.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\nf 1 2 3\np 4\n");
  ASSERT_TRUE(obj.ok()) << obj.status();
  EXPECT_THAT(obj->notices, Contains("1 point element (p) of the file not used: single points have no visible edges"));
}

}  // namespace
}  // namespace evpose::client
