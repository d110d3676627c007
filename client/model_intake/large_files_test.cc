// SPDX-License-Identifier: Apache-2.0

// Files of the formats that a server reads, when they are larger than what it accepts.
#include <filesystem>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/model_intake/model_intake.h"
#include "client/model_intake/scene_reader.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::SizeIs;

// A waved sheet with thickness: 20 x 20 squares above, as many below, and the sides between them.
ObjectModel Waved(const std::string& path) {
  std::string obj;
  constexpr int kSide = 21;
  for (int layer = 0; layer < 2; ++layer) {
    for (int i = 0; i < kSide * kSide; ++i) {
      const double x = 0.01 * (i % kSide), y = 0.01 * (i / kSide);
      absl::StrAppendFormat(&obj, "v %.8g %.8g %.8g\n", x, y, 0.02 * layer + 0.2 * x * x);
    }
  }
  const auto face = [&obj](int a, int b, int c, int d) {
    absl::StrAppend(&obj, "f ", a + 1, " ", b + 1, " ", c + 1, " ", d + 1, "\n");
  };
  constexpr int kLayer = kSide * kSide;
  for (int y = 0; y + 1 < kSide; ++y) {
    for (int x = 0; x + 1 < kSide; ++x) {
      const int a = y * kSide + x;
      face(a, a + kSide, a + kSide + 1, a + 1);
      face(kLayer + a, kLayer + a + 1, kLayer + a + kSide + 1, kLayer + a + kSide);
    }
  }
  for (int i = 0; i + 1 < kSide; ++i) {
    const int left = i * kSide, right = left + kSide - 1, back = (kSide - 1) * kSide + i;
    face(i, i + 1, kLayer + i + 1, kLayer + i);
    face(back + 1, back, kLayer + back, kLayer + back + 1);
    face(left + kSide, left, kLayer + left, kLayer + left + kSide);
    face(right, right + kSide, kLayer + right + kSide, kLayer + right);
  }
  EXPECT_TRUE(WriteFile(path, obj).ok());
  const absl::StatusOr<ObjectModel> model = LoadModelFile(path);
  EXPECT_TRUE(model.ok()) << model.status();
  return model.ok() ? *model : ObjectModel();
}

// The triangles as ASCII STL, which takes about 250 bytes for each.
std::string AsciiStlOf(const ObjectModel& model) {
  std::string stl = "solid waved\n";
  for (const auto& triangle : model.triangles) {
    stl += "  facet normal 0.000000e+00 0.000000e+00 0.000000e+00\n    outer loop\n";
    for (const uint32_t vertex : triangle) {
      const Eigen::Vector3d& v = model.vertices[vertex];
      absl::StrAppendFormat(&stl, "      vertex %.9e %.9e %.9e\n", v.x(), v.y(), v.z());
    }
    stl += "    endloop\n  endfacet\n";
  }
  return stl + "endsolid waved\n";
}

class LargeFilesTest : public testing::Test {
 protected:
  const TemporaryDirectory directory_;
};

TEST_F(LargeFilesTest, TextIsConvertedToTheMeshOfTheSameModel) {
  const std::string obj = directory_.File("waved.obj"), stl = directory_.File("waved.stl");
  const ObjectModel waved = Waved(obj);
  ASSERT_TRUE(WriteFile(stl, AsciiStlOf(waved)).ok());
  for (const std::string& path : {obj, stl}) {
    const size_t size = std::filesystem::file_size(path);
    const ModelFile as_it_is = ReadModelFile(path, 1.0, size).value();
    EXPECT_NE(as_it_is.format, evpose::ModelFormat::kMesh);
    const absl::StatusOr<ModelFile> file = ReadModelFile(path, 1.0, size - 1);
    ASSERT_TRUE(file.ok()) << file.status();
    EXPECT_EQ(file->format, evpose::ModelFormat::kMesh);
    EXPECT_LT(file->bytes.size(), size);
    const ObjectModel expected = LoadModelFile(path).value();
    const ObjectModel model = LoadModelFile(path, {.max_bytes = size - 1}).value();
    EXPECT_EQ(model.vertices, expected.vertices);
    EXPECT_EQ(model.triangles, expected.triangles);
    EXPECT_EQ(model.diameter_m, expected.diameter_m);
    EXPECT_EQ(model.notices, expected.notices);
    ASSERT_EQ(model.lines.size(), expected.lines.size());
    for (size_t i = 0; i < model.lines.size(); ++i) {
      EXPECT_EQ(model.lines[i].p1, expected.lines[i].p1);
      EXPECT_EQ(model.lines[i].p2, expected.lines[i].p2);
    }
  }
  const size_t stl_size = std::filesystem::file_size(stl);
  EXPECT_LT(ReadModelFile(stl, 1.0, stl_size - 1)->bytes.size(), stl_size / 6) << "points are shared";
}

TEST_F(LargeFilesTest, AnImplausibleSizeIsNoticedOnce) {
  const std::string path = directory_.File("waved.obj");
  Waved(path);
  const ObjectModel model = LoadModelFile(path, {.metres_per_unit = 1000.0, .max_bytes = 25'000}).value();
  EXPECT_THAT(model.notices, SizeIs(1));
  EXPECT_THAT(model.notices, Contains(HasSubstr("largest side 0.2 units: taken as 200 m; if these are metres pass")));
}

TEST_F(LargeFilesTest, WhatStaysTooLargeIsAnErrorWithTheSizesAndARemedy) {
  const std::string path = directory_.File("waved.obj");
  Waved(path);
  EXPECT_THAT(std::string(ReadModelFile(path, 1.0, 1024).status().message()),
              testing::AllOf(testing::StartsWith(path + ": its mesh takes 0.0"),
                             HasSubstr("MiB, but a server accepts 0.000977 MiB: simplify the model")));
  const std::string obj = ReadFile(path, 1u << 20).value();
  ASSERT_TRUE(WriteFile(path, obj + "l 1 2\n").ok());
  EXPECT_THAT(std::string(ReadModelFile(path, 1.0, 20'000).status().message()),
              HasSubstr("has line elements (l) and 0.0"));
  EXPECT_THAT(std::string(ReadModelFile(FindTestData("models/label_box.glb"), 1.0, 100).status().message()),
              HasSubstr("its mesh takes"));
}

TEST_F(LargeFilesTest, AFileBeyondEveryLimitIsNotRead) {
  const std::string path = directory_.File("sparse.stl");
  ASSERT_TRUE(WriteFile(path, "solid").ok());
  std::filesystem::resize_file(path, kMaxModelFileBytes + (size_t{88} << 20));
  EXPECT_EQ(
      ReadModelFile(path).status().message(),
      path + ": has 600 MiB, but at most 512 MiB are read: simplify the model, or export it as binary STL or PLY");
}

TEST_F(LargeFilesTest, AnObjWithImagesKeepsThem) {
  for (const char* name : {"label.mtl", "label.png", "label_box.obj"}) {
    std::filesystem::copy(FindTestData(absl::StrCat("models/", name)), directory_.File(name));
  }
  const std::string path = directory_.File("label_box.obj");
  const std::string obj = ReadFile(path, 1u << 20).value();
  ASSERT_TRUE(WriteFile(path, absl::StrCat(obj, "#", std::string(10'000, '.'), "\n")).ok());
  const absl::StatusOr<ModelFile> expected = ReadModelFile(path), file = ReadModelFile(path, 1.0, 10'000);
  ASSERT_TRUE(expected.ok() && file.ok()) << file.status();
  EXPECT_EQ(file->bytes, expected->bytes);
  EXPECT_EQ(file->notices, expected->notices);
}

}  // namespace
}  // namespace evpose::client
