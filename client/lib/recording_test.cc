// SPDX-License-Identifier: Apache-2.0
#include "evpose/recording.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "core/recordings/recording_header.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

class RecordingTest : public ::testing::Test {
 protected:
  RecordingTest()
      : directory_(std::filesystem::path(::testing::TempDir()) / ("evpose_recording." + std::to_string(getpid()))) {
    std::filesystem::create_directories(directory_);
  }
  ~RecordingTest() override { std::filesystem::remove_all(directory_); }

  std::string Write(const std::string& name, const std::string& contents) const {
    const std::string path = (directory_ / name).string();
    std::ofstream(path, std::ios::binary) << contents;
    return path;
  }

  const std::filesystem::path directory_;
};

TEST_F(RecordingTest, ChunksAreTheBytesAfterTheHeader) {
  const std::string data(100, '\0');
  const std::string path = Write("a.raw", MakeRawHeader(Encoding::kEvt2, {640, 480}) + data);
  RecordingOptions options;
  options.max_bytes = 16;
  const auto recording = Recording::Open(path, options);
  ASSERT_TRUE(recording.ok()) << recording.status();
  EXPECT_EQ((*recording)->encoding(), EventEncoding::kEvt2);
  EXPECT_EQ((*recording)->width_px(), 640);
  EXPECT_EQ((*recording)->height_px(), 480);
  size_t num_bytes = 0;
  for (auto chunk = (*recording)->Next(); chunk.ok() && !chunk->bytes.empty(); chunk = (*recording)->Next()) {
    EXPECT_LE(chunk->bytes.size(), 16u);
    num_bytes += chunk->bytes.size();
  }
  EXPECT_EQ(num_bytes, data.size());
}

TEST_F(RecordingTest, ErrorsNameThePathOrTheOption) {
  const auto missing = Recording::Open((directory_ / "missing.raw").string());
  EXPECT_EQ(missing.status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(missing.status().message(), HasSubstr("missing.raw"));
  RecordingOptions options;
  options.max_bytes = 12;
  const std::string path = Write("a.raw", MakeRawHeader(Encoding::kEvt2, {640, 480}) + std::string(8, '\0'));
  EXPECT_THAT(Recording::Open(path, options).status().message(), HasSubstr("max_bytes"));
}

TEST_F(RecordingTest, CameraIsReadFromCameraInfo) {
  const std::string path = Write("camera.yaml",
                                 "image_width: 640\nimage_height: 480\ndistortion_model: plumb_bob\n"
                                 "camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 501, 240, 0, 0, 1]}\n"
                                 "distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}\n");
  const auto camera = LoadCamera(path);
  ASSERT_TRUE(camera.ok()) << camera.status();
  EXPECT_EQ(camera->width_px, 640);
  EXPECT_EQ(camera->fy_px, 501.0);
  EXPECT_EQ(camera->distortion[0], 0.1);
  EXPECT_EQ(LoadCamera((directory_ / "missing.yaml").string()).status().code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace evpose::client
