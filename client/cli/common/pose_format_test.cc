// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pose_format.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "client/lib/messages/core_types.h"
#include "core/base/output_file.h"
#include "core/numerics/random.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

Pose MakePose() {
  Pose pose;
  pose.seq = 7;
  pose.object_id = "object";
  pose.latency = absl::Milliseconds(3);
  pose.t_us = 16'000'250;
  pose.camera_from_object.translation_m = {0.1, -0.25, 1.5};
  pose.state = TrackState::kDegraded;
  pose.num_events = 321;
  pose.explained_ratio = 0.5f;
  pose.residual_rms_px = 0.75f;
  pose.twist << 1, 2, 3, 4, 5, 6;
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column < 6; ++column)
      pose.covariance(row, column) = 10 * std::min(row, column) + std::max(row, column);
  }
  return pose;
}

TEST(PoseFormat, FollowsFromTheEnding) {
  EXPECT_EQ(*PoseFormatFromPath("a.tum"), PoseFormat::kTum);
  EXPECT_EQ(*PoseFormatFromPath("a.b/a.tum"), PoseFormat::kTum);
  EXPECT_EQ(*PoseFormatFromPath("a.csv"), PoseFormat::kCsv);
  EXPECT_EQ(*PoseFormatFromPath("a.jsonl"), PoseFormat::kJsonLines);
  EXPECT_EQ(*PoseFormatFromPath("a.mcap"), PoseFormat::kMcap);
  EXPECT_THAT(PoseFormatFromPath("a.json").status().message(), HasSubstr(".tum, .csv, .jsonl or .mcap"));
  EXPECT_THAT(PoseFormatFromPath("a.txt").status().message(), HasSubstr("a.txt: the name of a file of poses ends in"));
}

TEST(PoseFormat, Tum) {
  EXPECT_EQ(PoseHeader(PoseFormat::kTum), "");
  EXPECT_EQ(PoseLine(PoseFormat::kTum, MakePose()), "16.000250 0.10000000000000001 -0.25 1.5 0 0 0 1\n");
}

Pose AmbiguousPose() {
  Pose pose = MakePose();
  pose.state = TrackState::kAmbiguous;
  for (const double ratio : {0.25, -3.5}) {
    PoseAlternative alternative;
    alternative.camera_from_object.translation_m = {0.5, 0.0, ratio};
    alternative.camera_from_object.rotation = Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
    alternative.log_likelihood_ratio = ratio;
    pose.alternatives.push_back(alternative);
  }
  return pose;
}

TEST(PoseFormat, StatesATransformOtherThanTheDefault) {
  const PoseFrame frame = PoseFrame::ObjectFromCamera();
  EXPECT_EQ(PoseHeader(PoseFormat::kTum, frame),
            "# object_from_camera, timestamp tx ty tz qx qy qz qw: sensor clock, s; m\n");
  EXPECT_EQ(PoseLine(PoseFormat::kTum, MakePose(), frame), "16.000250 -0.10000000000000001 0.25 -1.5 0 0 0 1\n");
  EXPECT_EQ(PoseHeader(PoseFormat::kCsv, frame),
            std::string(absl::StripSuffix(PoseHeader(PoseFormat::kCsv), "\n")) + ",transform\n");
  EXPECT_THAT(PoseLine(PoseFormat::kCsv, MakePose(), frame), ::testing::EndsWith(",object_from_camera\n"));
  EXPECT_EQ(PoseHeader(PoseFormat::kJsonLines, frame), "");
  EXPECT_EQ(nlohmann::json::parse(PoseLine(PoseFormat::kJsonLines, MakePose(), frame))["transform"],
            "object_from_camera");
  EXPECT_EQ(nlohmann::json::parse(PoseLine(PoseFormat::kJsonLines, MakePose()))["transform"], "camera_from_object");
}

TEST(PoseFormat, TumHasNoAmbiguousPoses) { EXPECT_EQ(PoseLine(PoseFormat::kTum, AmbiguousPose()), ""); }

TEST(PoseFormat, CsvHasColumnsForFourAlternatives) {
  const std::vector<std::string> names = absl::StrSplit(absl::StripSuffix(PoseHeader(PoseFormat::kCsv), "\n"), ',');
  const std::vector<std::string> values =
      absl::StrSplit(absl::StripSuffix(PoseLine(PoseFormat::kCsv, AmbiguousPose()), "\n"), ',');
  ASSERT_EQ(names.size(), values.size());
  std::map<std::string, std::string> row;
  for (size_t i = 0; i < names.size(); ++i) row[names[i]] = values[i];
  EXPECT_EQ(row.at("state"), "AMBIGUOUS");
  EXPECT_EQ(row.at("num_alternatives"), "2");
  EXPECT_EQ(row.at("alt1_tz_m"), "0.25");
  EXPECT_EQ(row.at("alt1_qx"), "1");
  EXPECT_EQ(row.at("alt1_log_likelihood_ratio"), "0.25");
  EXPECT_EQ(row.at("alt2_tz_m"), "-3.5");
  EXPECT_EQ(row.at("alt2_log_likelihood_ratio"), "-3.5");
  EXPECT_EQ(row.at("alt3_tx_m"), "");
  EXPECT_EQ(row.at("alt4_log_likelihood_ratio"), "");
}

TEST(PoseFormat, JsonHasTheAlternatives) {
  const nlohmann::json json = nlohmann::json::parse(PoseLine(PoseFormat::kJsonLines, AmbiguousPose()));
  EXPECT_EQ(json["state"], "AMBIGUOUS");
  ASSERT_EQ(json["alternatives"].size(), 2u);
  EXPECT_EQ(json["alternatives"][0]["translation_m"], nlohmann::json({0.5, 0.0, 0.25}));
  EXPECT_EQ(json["alternatives"][1]["log_likelihood_ratio"], -3.5);
}

TEST(PoseFormat, CsvHasANameForEachNumber) {
  const std::vector<std::string> names = absl::StrSplit(PoseHeader(PoseFormat::kCsv), ',');
  const std::vector<std::string> values = absl::StrSplit(PoseLine(PoseFormat::kCsv, MakePose()), ',');
  ASSERT_EQ(names.size(), values.size());
  const auto value = [&](const std::string& name) -> std::string {
    for (size_t i = 0; i < names.size(); ++i) {
      if (names[i] == name) return values[i];
    }
    return "no such column";
  };
  EXPECT_EQ(value("pose_seq"), "7");
  EXPECT_EQ(value("t_us"), "16000250");
  EXPECT_EQ(value("ty_m"), "-0.25");
  EXPECT_EQ(value("qw"), "1");
  EXPECT_EQ(value("state"), "DEGRADED");
  EXPECT_EQ(value("num_events"), "321");
  EXPECT_EQ(value("residual_rms_px"), "0.75");
  EXPECT_EQ(value("wz_rad_per_s"), "6");
  EXPECT_EQ(value("cov_tx_tx"), "0");
  EXPECT_EQ(value("cov_ty_rx"), "13");
  EXPECT_EQ(value("cov_rz_rz"), "55");
  EXPECT_EQ(value("num_alternatives"), "0");
}

TEST(PoseFormat, TheLatestLossIsInCsvAndJsonLines) {
  const std::string without = PoseLine(PoseFormat::kCsv, MakePose());
  EXPECT_THAT(PoseHeader(PoseFormat::kCsv), ::testing::EndsWith(",lost_at_us,loss_cause\n"));
  EXPECT_THAT(without, ::testing::EndsWith(",,\n"));
  nlohmann::json json = nlohmann::json::parse(PoseLine(PoseFormat::kJsonLines, MakePose()));
  EXPECT_TRUE(json.at("lost_at_us").is_null() && json.at("loss_cause").is_null()) << json;
  Pose lost = MakePose();
  lost.latest_loss = {15'000'000, LossCause::kOutOfView};
  EXPECT_EQ(PoseLine(PoseFormat::kCsv, lost),
            std::string(absl::StripSuffix(without, ",\n")) + "15000000,OUT_OF_VIEW\n");
  json = nlohmann::json::parse(PoseLine(PoseFormat::kJsonLines, lost));
  EXPECT_EQ(json["lost_at_us"], 15'000'000);
  EXPECT_EQ(json["loss_cause"], "OUT_OF_VIEW");
  EXPECT_EQ(PoseLine(PoseFormat::kTum, lost), PoseLine(PoseFormat::kTum, MakePose()));
}

TEST(PoseFormat, JsonLine) {
  const nlohmann::json json = nlohmann::json::parse(PoseLine(PoseFormat::kJsonLines, MakePose()));
  EXPECT_EQ(json["pose_seq"], 7);
  EXPECT_EQ(json["translation_m"], nlohmann::json({0.1, -0.25, 1.5}));
  EXPECT_EQ(json["quaternion_xyzw"], nlohmann::json({0.0, 0.0, 0.0, 1.0}));
  EXPECT_EQ(json["state"], "DEGRADED");
  EXPECT_EQ(json["covariance_upper"].size(), 21u);
  EXPECT_EQ(json["covariance_upper"][8], 13.0);  // ty rx
  EXPECT_EQ(json["twist"][5], 6.0);
  EXPECT_FALSE(json.contains("latency"));  // differs from run to run
}

TEST(PoseFilesTest, HoldsHeaderAndPosesOnceCommitted) {
  const std::string path = ::testing::TempDir() + "/pose_format_test.csv";
  std::filesystem::remove(path);
  auto file = PoseFiles::Open(path, {"object"});
  ASSERT_TRUE(file.ok()) << file.status();
  file->Write(MakePose());
  EXPECT_FALSE(std::filesystem::exists(path));
  ASSERT_TRUE(file->Commit().ok());
  EXPECT_EQ(*ReadFile(path, 10'000), PoseHeader(PoseFormat::kCsv) + PoseLine(PoseFormat::kCsv, MakePose()));
  std::filesystem::remove(path);
}

TEST(PoseFilesTest, FullDiskIsReportedByCommit) {
  // /dev/full takes an opened file and refuses every byte.
  std::filesystem::remove(::testing::TempDir() + "/full.csv");
  std::filesystem::create_symlink("/dev/full", ::testing::TempDir() + "/full.csv");
  auto file = PoseFiles::Open(::testing::TempDir() + "/full.csv", {"object"});
  ASSERT_TRUE(file.ok()) << file.status();
  for (int i = 0; i < 1000; ++i) file->Write(MakePose());
  EXPECT_FALSE(file->Commit().ok());
  std::filesystem::remove(::testing::TempDir() + "/full.csv");
}

Pose SomeFramedPose() {
  Pose pose;
  pose.camera_from_object = {ExpSo3({0.1, -0.8, 0.3}), {0.1, -0.3, 1.5}};
  pose.twist << 0.1, 0.2, -0.3, 1.0, -2.0, 0.5;
  pose.alternatives.push_back({{ExpSo3({0.4, 0.0, 0.3}), {0.1, -0.2, 1.6}}, -1.0});
  return pose;
}

// The frames of the tests with the map from camera_from_object to the written transform.
RigidTransform Mount() { return {ExpSo3({-0.4, 0.2, 1.0}), {3.0, 2.0, 1.0}}; }
RigidTransform InFrame(const PoseFrame& frame, const RigidTransform& pose) {
  return frame.transform() == kObjectFromCamera ? pose.Inverse() : Mount() * pose;
}
std::vector<PoseFrame> Frames() { return {PoseFrame::ObjectFromCamera(), PoseFrame::WorldFromObject(Mount(), "base")}; }

TEST(PoseFrameTest, TransformsPoseAndAlternatives) {
  const Pose pose = SomeFramedPose();
  for (const PoseFrame& frame : Frames()) {
    const Pose out = frame.Apply(pose);
    EXPECT_LT(Difference(ToCore(out.camera_from_object), InFrame(frame, ToCore(pose.camera_from_object))).norm(),
              1e-14);
    EXPECT_LT(Difference(ToCore(out.alternatives.at(0).camera_from_object),
                         InFrame(frame, ToCore(pose.alternatives[0].camera_from_object)))
                  .norm(),
              1e-14);
    EXPECT_EQ(out.alternatives[0].log_likelihood_ratio, -1.0);
  }
  EXPECT_EQ(PoseFrame().Apply(pose).twist, pose.twist);
}

TEST(PoseFrameTest, ToCameraRevertsTheFrame) {
  Pose pose = SomeFramedPose();
  pose.covariance.diagonal() << 1, 4, 9, 16, 25, 36;
  std::vector<PoseFrame> frames = Frames();
  frames.emplace_back();
  for (const PoseFrame& frame : frames) {
    const Pose back = frame.ToCamera().Apply(frame.Apply(pose));
    EXPECT_LT(Difference(ToCore(back.camera_from_object), ToCore(pose.camera_from_object)).norm(), 1e-14);
    EXPECT_LT((back.covariance - pose.covariance).norm(), 1e-12) << frame.transform();
    EXPECT_LT((back.twist - pose.twist).norm(), 1e-14) << frame.transform();
  }
}

// The covariance of many perturbed poses after the transform, and the derivative of the transformed pose along the
// twist.
TEST(PoseFrameTest, CovarianceAndTwistAreThoseOfTheWrittenTransform) {
  Pose pose = SomeFramedPose();
  const RigidTransform camera_from_object = ToCore(pose.camera_from_object);
  Matrix6d root = Matrix6d::Zero();
  Random random(7);
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k <= i; ++k) root(i, k) = 1e-4 * random.Normal();
  }
  pose.covariance = root * root.transpose();
  for (const PoseFrame& frame : Frames()) {
    const RigidTransform centre = InFrame(frame, camera_from_object);
    const Pose out = frame.Apply(pose);
    Matrix6d sum = Matrix6d::Zero();
    constexpr int kSamples = 20'000;
    for (int i = 0; i < kSamples; ++i) {
      Vector6d normal;
      for (double& value : normal) value = random.Normal();
      const Vector6d error = Difference(InFrame(frame, Perturb(camera_from_object, root * normal)), centre);
      sum += error * error.transpose();
    }
    // Relative to the predicted covariance the sample's is the identity, with 1 / sqrt(samples) errors.
    const Matrix6d whitened = out.covariance.llt().matrixL().solve(sum / kSamples);
    const Matrix6d ratio = out.covariance.llt().matrixL().solve(whitened.transpose());
    EXPECT_LT((ratio - Matrix6d::Identity()).cwiseAbs().maxCoeff(), 0.05) << frame.transform();

    constexpr double kStep = 1e-6;
    const Vector6d twist = Difference(InFrame(frame, Perturb(camera_from_object, kStep * pose.twist)),
                                      InFrame(frame, Perturb(camera_from_object, -kStep * pose.twist))) /
                           (2.0 * kStep);
    EXPECT_LT((twist - out.twist).norm(), 1e-7) << frame.transform();
    EXPECT_EQ(out.covariance, out.covariance.transpose().eval());
  }
}

TEST(PoseFrameTest, ArgumentsChooseTheFrame) {
  std::ostringstream err;
  EXPECT_EQ(PoseFrameArguments().Read(err)->transform(), "camera_from_object");
  EXPECT_EQ((PoseFrameArguments{.pose = "object-from-camera"}.Read(err)->transform()), "object_from_camera");
  const std::string path = ::testing::TempDir() + "/pose_frame_test.txt";
  ASSERT_TRUE(WriteFile(path, "1 2 3 0 0 0 1\n").ok());
  EXPECT_EQ((PoseFrameArguments{.world_from_camera = path}.Read(err)->transform()), "world_from_object");
  ASSERT_TRUE(WriteFile(path, "frame_id: base\ntranslation: [1, 2, 3]\nrotation: [0, 0, 0, 1]\n").ok());
  EXPECT_EQ((PoseFrameArguments{.world_from_camera = path}.Read(err)->transform()), "base_from_object");
  for (const std::string name : {"camera", "evpose_camera"}) {
    ASSERT_TRUE(WriteFile(path, "frame_id: " + name + "\ntranslation: [1, 2, 3]\nrotation: [0, 0, 0, 1]\n").ok());
    EXPECT_THAT((PoseFrameArguments{.world_from_camera = path}.Read(err).status().message()),
                HasSubstr(path + ": frame_id: " + name + " is the name of the camera's own frame"));
  }
  ASSERT_TRUE(WriteFile(path, "1 2 3\n").ok());
  EXPECT_THAT((PoseFrameArguments{.world_from_camera = path}.Read(err).status().message()),
              HasSubstr(path + ": has 3 numbers"));
  EXPECT_EQ(err.str(), "");
  ASSERT_TRUE(WriteFile(path, "300 -400 1200 0 0 0 1\n").ok());  // millimetres
  EXPECT_TRUE((PoseFrameArguments{.world_from_camera = path}.Read(err).ok()));
  EXPECT_EQ(err.str(),
            "evpose: " + path + ": the camera is 1300 m from the origin of world: translations are in metres\n");
}

TEST(PoseFrameTest, DescriptionsDifferWithTheNumbers) {
  RigidTransform other = Mount();
  other.translation_m.x() += 1e-12;
  EXPECT_NE(PoseFrame::WorldFromObject(other, "base").Description(),
            PoseFrame::WorldFromObject(Mount(), "base").Description());
  EXPECT_NE(PoseFrame::ObjectFromCamera().Description(), PoseFrame().Description());
}

TEST(PoseFormat, TheStateOfAConfirmedPoseDoesNotRepeatThePose) {
  EXPECT_EQ(StateJson(MakePose()),
            R"({"pose_seq":7,"object_id":"object","t_us":16000250,"state":"DEGRADED","num_events":321,)"
            R"("explained_ratio":0.5,"residual_rms_px":0.75,"lost_at_us":null,"loss_cause":null})");
  // The state of an AMBIGUOUS pose has all fields of a JSON line, because no other message contains the pose.
  EXPECT_EQ(StateJson(AmbiguousPose()) + "\n", PoseLine(PoseFormat::kJsonLines, AmbiguousPose()));
}

TEST(PoseFrame, NamesTheFrameOfThePose) {
  EXPECT_EQ(PoseFrame().FrameId("part"), "evpose_camera");
  EXPECT_EQ(PoseFrame().world_from_camera(), std::nullopt);
  EXPECT_EQ(PoseFrame::ObjectFromCamera().FrameId("part"), "part");
  const PoseFrame frame = PoseFrame::WorldFromObject({.translation_m = {1, 2, 3}}, "cell");
  EXPECT_EQ(frame.FrameId("part"), "cell");
  EXPECT_EQ(frame.world_from_camera()->first, "cell");
  EXPECT_EQ(frame.world_from_camera()->second.translation_m, Eigen::Vector3d(1, 2, 3));
}

TEST(PoseFiles, McapFilesTakeMoreThanPoses) {
  const std::string path = ::testing::TempDir() + "/pose_files_{object}.mcap";
  auto files = PoseFiles::Open(path, {"a", "b"}, {.epoch_ns = 0});
  ASSERT_TRUE(files.ok()) << files.status();
  EXPECT_EQ(files->recorders().size(), 2u);
  Pose pose = MakePose();
  pose.object_id = "b";
  files->Write(pose);
  ASSERT_TRUE(files->Commit().ok());
  const auto size_of = [](const std::string& id) {
    return std::filesystem::file_size(::testing::TempDir() + "/pose_files_" + id + ".mcap");
  };
  EXPECT_GT(size_of("b"), size_of("a") + 1000);
  auto text = PoseFiles::Open(::testing::TempDir() + "/pose_files.csv", {"a"});
  EXPECT_TRUE(text->recorders().empty());
}

// The epoch that these arguments give, or the message of the error.
std::string EpochOf(const std::vector<std::string>& words, const std::string& out = "poses.mcap") {
  CLI::App app;
  RecordingArguments arguments;
  arguments.AddTo(app, "7");
  try {
    app.parse(std::vector<std::string>(words.rbegin(), words.rend()));
  } catch (const CLI::ParseError& error) {
    return error.what();
  }
  const absl::Status status = arguments.Check(out);
  if (!status.ok()) return std::string(status.message());
  const std::optional<int64_t> epoch_ns = arguments.EpochNs(7);
  return epoch_ns ? absl::StrCat(*epoch_ns) : "host";
}

TEST(RecordingArguments, TheEpochIsANumberOfSecondsOrThatOfTheHost) {
  EXPECT_EQ(EpochOf({}), "7");
  EXPECT_EQ(EpochOf({"--epoch", "host"}), "host");
  EXPECT_EQ(EpochOf({"--epoch", "0"}), "0");
  EXPECT_EQ(EpochOf({"--epoch", "1700000000.123456789"}), "1700000000123456789");
  EXPECT_EQ(EpochOf({"--epoch", "2147483647"}), "2147483647000000000");
  for (const char* const text : {"2147483648", "-1", "1e9", "1h", "", ".", "x"}) {
    EXPECT_THAT(EpochOf({"--epoch", text}), HasSubstr("is neither host nor a number of seconds")) << text;
  }
  EXPECT_THAT(EpochOf({"--event-images", "3"}), HasSubstr("--event-images"));
  EXPECT_EQ(EpochOf({"--event-images", "4"}), "7");
  EXPECT_THAT(EpochOf({"--epoch", "1"}, "poses.tum"), HasSubstr("--epoch: is for an --out whose name ends in .mcap"));
  EXPECT_THAT(EpochOf({"--event-images", "1"}, ""), HasSubstr("--event-images: is for an --out whose name ends"));
}

}  // namespace
}  // namespace evpose::client
