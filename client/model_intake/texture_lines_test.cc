// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/texture_lines.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <utility>

#include "client/model_intake/model_intake.h"
#include "client/model_intake/texture_edges.h"
#include "core/base/byte_order.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/models/mesh_message.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using testing::Contains;
using testing::HasSubstr;

// A dark disc on a bright ground.
cv::Mat Disc(double radius_px) {
  constexpr int kFraction = 6;
  cv::Mat image(128, 128, CV_8U, cv::Scalar(220));
  cv::circle(image, {64 << kFraction, 64 << kFraction}, static_cast<int>(radius_px * (1 << kFraction)), cv::Scalar(40),
             cv::FILLED, cv::LINE_AA, kFraction);
  return image;
}

TEST(TextureEdgesTest, TheRimOfADiscIsOneRingToAFractionOfAPixel) {
  const cv::Mat image = Disc(40.0);
  const std::vector<TextureEdge> edges = FindTextureEdges(image, cv::Mat(image.size(), CV_8U, cv::Scalar(255)));
  ASSERT_EQ(edges.size(), 1u);
  EXPECT_EQ(edges[0].points.front(), edges[0].points.back());
  EXPECT_GT(edges[0].points.size(), 12u);
  for (const Eigen::Vector2d& point : edges[0].points) {
    EXPECT_NEAR((point - Eigen::Vector2d(64, 64)).norm(), 40.0, 0.75);
  }
  // log((220 / 255)^2.2 + 0.02) - log((40 / 255)^2.2 + 0.02)
  EXPECT_NEAR(edges[0].contrast, 2.99, 0.3);
}

TEST(TextureEdgesTest, WeakEdgesAndThoseOutsideTheMaskAreNotTaken) {
  cv::Mat image(64, 64, CV_8U, cv::Scalar(200));
  image.colRange(32, 64).setTo(190);
  cv::Mat everywhere(image.size(), CV_8U, cv::Scalar(255));
  EXPECT_TRUE(FindTextureEdges(image, everywhere).empty());
  image.colRange(32, 64).setTo(20);
  EXPECT_EQ(FindTextureEdges(image, everywhere).size(), 1u);
  everywhere.colRange(20, 44).setTo(0);
  EXPECT_TRUE(FindTextureEdges(image, everywhere).empty());
}

TEST(TextureEdgesTest, OptionsOutOfRangeAreNamed) {
  Scene scene;
  EXPECT_THAT(std::string(AddTextureLines(scene, {.min_length_ratio = 1.5}).message()),
              HasSubstr("TextureLineOptions.min_length_ratio"));
  EXPECT_THAT(std::string(AddTextureLines(scene, {.edges = {.min_contrast = 0.0}}).message()),
              HasSubstr("TextureEdgeOptions.min_contrast"));
  EXPECT_THAT(std::string(AddTextureLines(scene, {.edges = {.smoothing_px = std::nan("")}}).message()),
              HasSubstr("TextureEdgeOptions.smoothing_px"));
  EXPECT_TRUE(TextureLineOptions().Validate().ok());
}

// The unit square, of two triangles, with the image on it `repetitions` times in each direction.
Scene Square(const cv::Mat& image, double repetitions) {
  Scene scene;
  scene.mesh.points = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  scene.mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  const double r = repetitions;
  scene.image_of = {0, 0};
  scene.image_positions = {{Eigen::Vector2d(0, 0), Eigen::Vector2d(r, 0), Eigen::Vector2d(r, r)},
                           {Eigen::Vector2d(0, 0), Eigen::Vector2d(r, r), Eigen::Vector2d(0, r)}};
  scene.images = {image};
  return scene;
}

double Length(const RawMesh& mesh) {
  double length = 0.0;
  for (const auto& [a, b] : mesh.lines) length += (mesh.points[a] - mesh.points[b]).norm();
  return length;
}

TEST(TextureLinesTest, EdgesMoveToTheObjectAndImagesRepeat) {
  const double circumference = 2.0 * M_PI * 40.0 / 128.0;
  Scene once = Square(Disc(40.0), 1.0);
  ASSERT_TRUE(AddTextureLines(once).ok());
  EXPECT_NEAR(Length(once.mesh), circumference, 0.02 * circumference);
  for (const auto& [a, b] : once.mesh.lines) {
    // Pixel 64 is at (64 + 0.5) / 128 from the left and from the top.
    const Eigen::Vector3d centre(64.5 / 128.0, 1.0 - 64.5 / 128.0, 0.0);
    for (const uint32_t end : {a, b}) EXPECT_NEAR((once.mesh.points[end] - centre).norm(), 40.0 / 128.0, 0.01);
  }
  Scene thrice = Square(Disc(40.0), 3.0);
  ASSERT_TRUE(AddTextureLines(thrice).ok());
  EXPECT_NEAR(Length(thrice.mesh), 3.0 * circumference, 0.06 * circumference);
}

TEST(TextureLinesTest, AnImageThatOpenCvCannotProcessIsAnError) {
  Scene scene = Square(cv::Mat(64, 64, CV_64FC4, cv::Scalar(1)), 1.0);
  EXPECT_THAT(std::string(AddTextureLines(scene).message()), HasSubstr("the edges of an image cannot be found: "));
}

TEST(TextureLinesTest, TheNumberOfLinesIsBounded) {
  Scene scene = Square(Disc(40.0), 1.0);
  ASSERT_TRUE(AddTextureLines(scene, {.max_lines = 5}).ok());
  EXPECT_TRUE(scene.mesh.lines.empty()) << "an edge is taken as a whole or not at all";
  EXPECT_THAT(scene.notices, Contains(HasSubstr(": 0 painted lines of ")));
}

class LabelTest : public testing::TestWithParam<const char*> {};

TEST_P(LabelTest, TheSquareOnTheBoxBecomesPaintedLines) {
  const absl::StatusOr<ModelFile> file = ReadModelFile(FindTestData("models/" + std::string(GetParam())));
  ASSERT_TRUE(file.ok()) << file.status();
  ASSERT_EQ(file->format, evpose::ModelFormat::kMesh);
  const RawMesh mesh = server::ParseMesh(AsBytes(file->bytes), 100).value();
  EXPECT_NEAR(Length(mesh), 2.0 * (0.005 + 0.010), 0.001);
  for (const auto& line : mesh.lines) {
    for (const uint32_t end : line) {
      const Eigen::Vector3d& point = mesh.points[end];
      EXPECT_NEAR(point.z(), 0.03, 1e-8);
      // Distance from the outline of the square: smoothing rounds its corners.
      const double x = std::abs(point.x() - 0.005) / 0.0025, y = std::abs(point.y() - 0.010) / 0.0050;
      EXPECT_NEAR(std::max(x, y), 1.0, 1.5 / 16.0) << "one and a half of its pixels";
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Formats, LabelTest,
                         testing::Values("label_box.gltf", "label_box.glb", "label_box.obj", "label_box_draco.gltf"),
                         [](const auto& param) {
                           std::string name = param.param;
                           std::replace(name.begin(), name.end(), '.', '_');
                           return name;
                         });

TEST(TextureLinesTest, AMissingImageIsANoticeAndTheModelIsReadWithout) {
  const TemporaryDirectory directory;
  for (const char* name : {"label_box.gltf", "label_box.obj", "label.mtl"}) {
    std::filesystem::copy(FindTestData("models/" + std::string(name)), directory.File(name));
  }
  for (const char* name : {"label_box.gltf", "label_box.obj"}) {
    const absl::StatusOr<ObjectModel> model = LoadModelFile(directory.File(name));
    ASSERT_TRUE(model.ok()) << model.status();
    EXPECT_EQ(model->lines.size(), 12u);
    EXPECT_THAT(model->notices, Contains(HasSubstr("image label.png: its edges are not used")));
  }
}

TEST(TextureLinesTest, ImagesThatCannotBeUsedAreNotices) {
  using nlohmann::json;
  const json box = json::parse(ReadFile(FindTestData("models/label_box.gltf"), 1u << 20).value());
  json damaged = box, moved = box;
  damaged["images"][0]["uri"] = "data:image/png;base64,AAAA";
  moved["materials"][1]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"]["KHR_texture_transform"]["scale"] = {
      2, 2};
  moved["extensionsRequired"] = {"KHR_texture_transform"};
  moved["extensionsUsed"] = {"KHR_texture_transform"};
  const TemporaryDirectory directory;
  std::filesystem::copy(FindTestData("models/label.png"), directory.File("label.png"));
  for (const auto& [document, says] : {std::pair(damaged, "its edges are not used: it cannot be decoded"),
                                       std::pair(moved, "because its material moves it on the surface")}) {
    ASSERT_TRUE(WriteFile(directory.File("box.gltf"), document.dump()).ok());
    const absl::StatusOr<ObjectModel> model = LoadModelFile(directory.File("box.gltf"));
    ASSERT_TRUE(model.ok()) << model.status();
    EXPECT_EQ(model->lines.size(), 12u);
    EXPECT_THAT(model->notices, Contains(HasSubstr(says)));
  }
}

}  // namespace
}  // namespace evpose::client
