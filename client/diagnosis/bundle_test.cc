// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/bundle.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <functional>
#include <map>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "client/diagnosis/tar_file.h"
#include "core/base/output_file.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

Bundle Example() {
  Bundle bundle;
  bundle.version = {"1.2.3", "abcdef"};
  bundle.recording = "% end\nevents";
  bundle.model = "v 0 0 0\n";
  bundle.upload = {
      .format = ModelFormat::kPly, .metres_per_unit = 1e-3, .crease_angle_deg = 20.1, .surface = ModelSurface::kAsIs};
  bundle.camera = {.width_px = 640, .height_px = 480, .fx_px = 500.1, .fy_px = 501.3, .cx_px = 319.7, .cy_px = 240.2};
  bundle.sensor.blur_px = 0.1 + 0.2;
  bundle.initial_pose = "0 0 1 0 0 0 1";
  bundle.poses = "{}\n";
  bundle.report = "[]\n";
  return bundle;
}

class BundleTest : public ::testing::Test {
 protected:
  void SetUp() override {
    path_ = absl::StrCat(::testing::TempDir(), "/bundle_test_",
                         ::testing::UnitTest::GetInstance()->current_test_info()->name(), ".tar");
    const absl::Status written = WriteBundle(path_, Example());
    ASSERT_TRUE(written.ok()) << written;
  }

  // Returns the status of reading the bundle after `change` to its files; the sums are computed again.
  absl::Status AfterChange(const std::function<void(std::map<std::string, std::string>&)>& change) {
    EXPECT_TRUE(WriteBundle(path_, Example()).ok());
    auto files = ReadTar(path_, 1 << 20);
    EXPECT_TRUE(files.ok());
    change(*files);
    std::string sums;
    const std::string folder = "evpose-bundle/";
    for (const auto& [name, contents] : *files) {
      if (name == folder + "SHA256SUMS" || !name.starts_with(folder)) continue;
      const auto* bytes = reinterpret_cast<const uint8_t*>(contents.data());
      absl::StrAppend(&sums, Sha256Hex({bytes, contents.size()}), "  ", name.substr(folder.size()), "\n");
    }
    if (files->contains(folder + "SHA256SUMS")) (*files)[folder + "SHA256SUMS"] = sums;
    auto writer = TarWriter::Create(path_);
    for (const auto& [name, contents] : *files) writer->Add(name, contents);
    EXPECT_TRUE(writer->Commit().ok());
    return ReadBundle(path_).status();
  }

  std::string path_;
};

TEST_F(BundleTest, ReadsWhatItWritesToTheBit) {
  const auto bundle = ReadBundle(path_);
  ASSERT_TRUE(bundle.ok()) << bundle.status();
  const Bundle expected = Example();
  EXPECT_EQ(bundle->version.version, expected.version.version);
  EXPECT_EQ(bundle->version.commit, expected.version.commit);
  EXPECT_EQ(bundle->recording, expected.recording);
  EXPECT_EQ(bundle->model, expected.model);
  EXPECT_EQ(bundle->upload.format, expected.upload.format);
  EXPECT_EQ(bundle->upload.metres_per_unit, expected.upload.metres_per_unit);
  EXPECT_EQ(bundle->upload.crease_angle_deg, expected.upload.crease_angle_deg);
  EXPECT_EQ(bundle->upload.surface, expected.upload.surface);
  EXPECT_EQ(bundle->camera, expected.camera);
  EXPECT_EQ(bundle->sensor, expected.sensor);
  EXPECT_EQ(bundle->initial_pose, expected.initial_pose);
  EXPECT_EQ(bundle->poses, expected.poses);
  EXPECT_EQ(bundle->report, expected.report);
}

TEST_F(BundleTest, ABundleThatCouldNotBeReadIsNotWritten) {
  Bundle large = Example();
  large.poses.assign(size_t{256} << 20, ' ');
  const std::string before = *ReadFile(path_, 1 << 20);
  const absl::Status status = WriteBundle(path_, large);
  EXPECT_TRUE(absl::IsInvalidArgument(status)) << status;
  EXPECT_THAT(status.message(), HasSubstr(path_));
  EXPECT_THAT(status.message(), HasSubstr("shorter --duration"));
  EXPECT_EQ(*ReadFile(path_, 1 << 20), before);
}

TEST_F(BundleTest, AChangedByteOfAnyFileIsAnError) {
  const std::string bytes = *ReadFile(path_, 1 << 20);
  const auto files = *ReadTar(path_, 1 << 20);
  for (const auto& [name, contents] : files) {
    const size_t begin = bytes.find(name) + 512;
    ASSERT_EQ(bytes.substr(begin, contents.size()), contents) << name;
    std::string changed = bytes;
    changed[begin] = static_cast<char>(changed[begin] ^ 1);
    ASSERT_TRUE(WriteFile(path_, changed).ok());
    const absl::Status status = ReadBundle(path_).status();
    EXPECT_TRUE(absl::IsDataLoss(status)) << name << ": " << status;
    EXPECT_THAT(status.message(), HasSubstr(path_));
  }
}

TEST_F(BundleTest, MissingAndWrongParts) {
  for (const char* name : {"bundle.json", "recording.raw", "model.ply", "camera.yaml", "sensor.yaml", "poses.jsonl",
                           "report.json", "SHA256SUMS"}) {
    const std::string member = absl::StrCat("evpose-bundle/", name);
    const absl::Status status = AfterChange([&](auto& files) { EXPECT_EQ(files.erase(member), 1u); });
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << status;
    EXPECT_THAT(status.message(), HasSubstr("has no " + member));
  }
  const auto error_of = [&](const char* name, const char* from, const char* to) {
    return std::string(AfterChange([&](auto& files) {
                         std::string& text = files[absl::StrCat("evpose-bundle/", name)];
                         EXPECT_GT(absl::StrReplaceAll({{from, to}}, &text), 0) << from << " in " << text;
                       }).message());
  };
  EXPECT_THAT(error_of("bundle.json", "\"format\": 1", "\"format\": 2"), HasSubstr("install the version that made it"));
  EXPECT_THAT(error_of("bundle.json", "{", "["), HasSubstr("is no JSON object"));
  EXPECT_THAT(error_of("bundle.json", "\"as-is\"", "\"rough\""), HasSubstr("model.surface is missing or wrong"));
  EXPECT_THAT(error_of("bundle.json", "\"model.ply\"", "\"../model.ply\""),
              HasSubstr("model.file is missing or wrong"));
  EXPECT_THAT(error_of("bundle.json", "1.2.3", "\\u001b[31m"), HasSubstr("version is missing or wrong"));
  EXPECT_THAT(error_of("bundle.json", "0.001", "\"0.001\""), HasSubstr("metres_per_unit is missing or wrong"));
  EXPECT_THAT(error_of("camera.yaml", "640", "none"), HasSubstr("camera.yaml"));
  EXPECT_THAT(error_of("sensor.yaml", "blur_px", "blurred"), HasSubstr("sensor.yaml"));
  EXPECT_THAT(std::string(AfterChange([](auto& files) { files["other/a"] = ""; }).message()),
              HasSubstr("has other/a beside evpose-bundle/"));
}

TEST_F(BundleTest, ContainsNothingOfTheMachine) {
  const std::string bytes = *ReadFile(path_, 1 << 20);
  EXPECT_THAT(bytes, ::testing::Not(HasSubstr(::testing::TempDir())));
  EXPECT_FALSE(WriteBundle(path_ + ".none/a.tar", Example()).ok());
}

}  // namespace
}  // namespace evpose::client
