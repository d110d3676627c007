// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/scene_files.h"

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/strip.h"
#include "client/model_intake/model_intake.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;
using testing::SizeIs;

std::string Data(const char* name) { return ReadFile(FindTestData(absl::StrCat("models/", name)), 1u << 20).value(); }

TEST(FindSceneFileTest, ReadsNamesAsExportersWriteThem) {
  const TemporaryDirectory temporary;
  const std::filesystem::path directory = temporary.File("a%20b");
  std::filesystem::create_directories(directory / "tex");
  for (const char* name : {"my part.bin", "100%25.png", "tex/front label.png", "beside.png"}) {
    ASSERT_TRUE(WriteFile((directory / name).string(), "x").ok());
  }
  EXPECT_EQ(FindSceneFile(directory, "my part.bin"), directory / "my part.bin");
  EXPECT_EQ(FindSceneFile(directory, "my%20part.bin"), directory / "my part.bin");
  EXPECT_EQ(FindSceneFile(directory, "100%25.png"), directory / "100%25.png") << "the name as it is comes first";
  EXPECT_EQ(FindSceneFile(directory, "tex\\front label.png"), directory / "tex/front label.png");
  EXPECT_EQ(FindSceneFile(directory, "tex/front%20label.png"), directory / "tex/front label.png");
  EXPECT_EQ(FindSceneFile(directory, "C:\\work\\beside.png"), directory / "beside.png");
  EXPECT_EQ(FindSceneFile(directory, "none%2.png"), directory / "none%2.png");
}

// The box whose buffer and image are files beside it, with spaces in their names.
class SceneWithFilesTest : public testing::Test {
 protected:
  void SetUp() override {
    json document = json::parse(Data("label_box.gltf"));
    std::string& uri = document["buffers"][0]["uri"].get_ref<std::string&>();
    std::string bytes;
    ASSERT_TRUE(absl::Base64Unescape(absl::StripPrefix(uri, "data:application/octet-stream;base64,"), &bytes));
    uri = "my%20part.bin";
    document["images"][0]["uri"] = "front%20label.png";
    std::filesystem::create_directories(directory_.File("a folder 100%"));
    Write("my part.bin", bytes);
    Write("front label.png", Data("label.png"));
    Write("my part.gltf", document.dump());
  }

  std::string Path(const std::string& name) const { return directory_.File("a folder 100%/" + name); }
  void Write(const std::string& name, const std::string& content) { ASSERT_TRUE(WriteFile(Path(name), content).ok()); }

  const TemporaryDirectory directory_;
};

TEST_F(SceneWithFilesTest, EncodedNamesAreFound) {
  const absl::StatusOr<ObjectModel> model = LoadModelFile(Path("my part.gltf"));
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_THAT(model->vertices, SizeIs(8));
  EXPECT_GE(model->lines.size(), 16u) << "with the label";
}

TEST_F(SceneWithFilesTest, AMissingBufferIsNamed) {
  std::filesystem::remove(Path("my part.bin"));
  EXPECT_THAT(std::string(LoadModelFile(Path("my part.gltf")).status().message()),
              AllOf(HasSubstr("cannot be read"), HasSubstr("my%20part.bin")));
}

TEST_F(SceneWithFilesTest, AnObjOfWindowsHasItsImage) {
  std::filesystem::create_directories(Path("tex"));
  Write("tex/label.png", Data("label.png"));
  Write("label.mtl", absl::StrReplaceAll(Data("label.mtl"), {{"label.png", "tex\\label.png"}}));
  // Its first statement follows a byte order mark.
  const std::string obj = Data("label_box.obj");
  const std::string points = obj.substr(obj.find("v "));
  Write("part.obj", absl::StrCat("\xEF\xBB\xBF", points.substr(0, points.find("vt ")), "mtllib label.mtl\n",
                                 points.substr(points.find("vt "))));
  const absl::StatusOr<ObjectModel> model = LoadModelFile(Path("part.obj"));
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_THAT(model->vertices, SizeIs(8));
  EXPECT_GE(model->lines.size(), 16u);
  EXPECT_THAT(model->notices, Not(Contains(HasSubstr("not used"))));
}

TEST_F(SceneWithFilesTest, LinesOfAFileAreNoticed) {
  json document = json::parse(ReadFile(Path("my part.gltf"), 1u << 20).value());
  json& primitives = document["meshes"][0]["primitives"];
  primitives[1]["mode"] = 1;  // LINES
  primitives[1].erase("material");
  Write("lines.gltf", document.dump());
  EXPECT_THAT(LoadModelFile(Path("lines.gltf"))->notices,
              Contains(HasSubstr("3 lines of the file taken as visible edges that are drawn on the surface; export the "
                                 "model without lines if nothing is drawn there")));
}

}  // namespace
}  // namespace evpose::client
