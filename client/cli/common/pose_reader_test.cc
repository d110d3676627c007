// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pose_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/common/pose_records.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/base/temporary_directory_testing.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

absl::StatusOr<ReadPoses> ReadCsv(const std::string& text) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("some.csv");
  EVPOSE_RETURN_IF_ERROR(WriteFile(path, text));
  return ReadPoseFile(path);
}

Pose SomePose(int64_t t_us, const std::string& object = "cube") {
  Pose pose;
  pose.object_id = object;
  pose.t_us = t_us;
  pose.camera_from_object = {ExpSo3({0.1, -0.2, 0.3}), {0.1, 1.0 / 3.0, 1.5}};
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k < 6; ++k) pose.covariance(i, k) = 1e-6 * (1 + i + k) / 7.0;
  }
  return pose;
}

std::string Csv(const std::vector<Pose>& poses) {
  std::string text = PoseHeader(PoseFormat::kCsv);
  for (const Pose& pose : poses) text += PoseLine(PoseFormat::kCsv, pose);
  return text;
}

TEST(PoseReaderTest, ReadsWrittenFiles) {
  const std::string path = (std::filesystem::path(::testing::TempDir()) / "evpose_pose_reader.csv").string();
  ASSERT_TRUE(WriteFile(path, Csv({SomePose(16'000'001), SomePose(16'001'001)})).ok());
  const auto poses = ReadPoseFile(path);
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->trajectory.size(), 2u);
  ASSERT_EQ(poses->covariances.size(), 2u);
  const Pose expected = SomePose(0);
  EXPECT_EQ(poses->trajectory[1].t_us, 16'001'001);
  EXPECT_EQ(poses->trajectory[1].camera_from_object.translation_m, expected.camera_from_object.translation_m);
  EXPECT_LT(RotationAngle(poses->trajectory[1].camera_from_object.rotation, expected.camera_from_object.rotation),
            1e-7);
  EXPECT_EQ(poses->covariances[1], expected.covariance);
}

// The poses of one run in each frame, in both formats.
TEST(PoseReaderTest, ReadsTheFrameOfTheFile) {
  const RigidTransform world_from_camera{ExpSo3({-0.4, 0.2, 1.0}), {3.0, 2.0, 1.0}};
  const PoseFrame robot = PoseFrame::WorldFromObject(world_from_camera, "base");
  const Pose pose = SomePose(16'000'001);
  for (const auto& [ending, format] : {std::pair{".tum", PoseFormat::kTum}, {".csv", PoseFormat::kCsv}}) {
    const std::string path = (std::filesystem::path(::testing::TempDir()) / "evpose_frames").string() + ending;
    const auto write = [&, format = format](const PoseFrame& frame) {
      ASSERT_TRUE(WriteFile(path, PoseHeader(format, frame) + PoseLine(format, pose, frame)).ok());
    };
    write(PoseFrame::ObjectFromCamera());
    EXPECT_EQ(ReadPoseFile(path)->transform, "object_from_camera");
    const auto back = ReadCameraPoses(path);
    ASSERT_TRUE(back.ok()) << back.status();
    const RigidTransform expected = {pose.camera_from_object.rotation, pose.camera_from_object.translation_m};
    EXPECT_LT(Difference(back->trajectory.at(0).camera_from_object, expected).norm(), 1e-7);
    if (format == PoseFormat::kCsv) {
      EXPECT_LT((back->covariances.at(0) - pose.covariance).norm(), 1e-12 * pose.covariance.norm());
    }

    write(robot);
    const auto in_base = ReadPoseFile(path);
    ASSERT_TRUE(in_base.ok()) << in_base.status();
    EXPECT_EQ(in_base->transform, "base_from_object");
    EXPECT_LT(Difference(in_base->trajectory.at(0).camera_from_object, world_from_camera * expected).norm(), 1e-7);
    EXPECT_THAT(ReadCameraPoses(path).status().message(),
                HasSubstr(path + ": its poses are base_from_object; give poses of a run without --world-from-camera"));
    EXPECT_THAT(ReadCameraPoses(path, PoseFrame::WorldFromObject(world_from_camera, "world")).status().message(),
                HasSubstr(path + ": its poses are base_from_object, and not world_from_object; give"));
    const auto of_camera = ReadCameraPoses(path, robot);
    ASSERT_TRUE(of_camera.ok()) << of_camera.status();
    EXPECT_LT(Difference(of_camera->trajectory.at(0).camera_from_object, expected).norm(), 1e-7);
    if (format == PoseFormat::kCsv) {
      EXPECT_LT((of_camera->covariances.at(0) - pose.covariance).norm(), 1e-12 * pose.covariance.norm());
    } else {
      EXPECT_EQ(ReadTruePoses(path, robot)->size(), 1u);
      EXPECT_EQ(ReadTruePoses(path).status(), ReadCameraPoses(path).status());
      EXPECT_EQ(ReadTruePoses(path, std::nullopt)->at(0).camera_from_object,
                in_base->trajectory.at(0).camera_from_object);
    }

    write(PoseFrame());
    EXPECT_EQ(ReadPoseFile(path)->transform, "camera_from_object");
  }
  EXPECT_EQ(ReadCsv("t_us,tx_m,ty_m,tz_m,qx,qy,qz,qw\n")->transform, "camera_from_object");
}

TEST(PoseReaderTest, ColumnsInAnyOrderAndWithoutCovariance) {
  const auto poses = ReadCsv("qw,qz,qy,qx,tz_m,ty_m,tx_m,t_us\r\n1,0,0,0,3,2,1,7\r\n");
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->trajectory.size(), 1u);
  EXPECT_EQ(poses->trajectory[0].t_us, 7);
  EXPECT_EQ(poses->trajectory[0].camera_from_object.translation_m, Eigen::Vector3d(1, 2, 3));
  EXPECT_TRUE(poses->covariances.empty());
}

TEST(PoseReaderTest, AmbiguousPosesAreNoPartOfTheTrajectory) {
  Pose ambiguous = SomePose(6);
  ambiguous.state = TrackState::kAmbiguous;
  ambiguous.alternatives = {{ambiguous.camera_from_object, -1.0}};
  const auto poses = ReadCsv(Csv({SomePose(5), ambiguous, SomePose(7)}));
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->trajectory.size(), 2u);
  EXPECT_EQ(poses->trajectory[1].t_us, 7);
  EXPECT_EQ(poses->covariances.size(), 2u);
  EXPECT_THAT(poses->ambiguous_us, ::testing::ElementsAre(6));
  EXPECT_FALSE(ReadCsv(Csv({ambiguous, SomePose(6)})).ok());
}

TEST(PoseReaderTest, LossesAreBeforeThePosesThatFollowThem) {
  const auto lost = [](int64_t t_us, std::optional<Loss> loss, TrackState state = TrackState::kTracking) {
    Pose pose = SomePose(t_us);
    pose.latest_loss = loss;
    pose.state = state;
    return pose;
  };
  const Loss first{6, LossCause::kContradicted}, second{8, LossCause::kOutOfView};
  const std::vector<Pose> poses = {lost(5, std::nullopt), lost(7, first), lost(8, first),
                                   lost(9, second, TrackState::kAmbiguous), lost(10, second)};
  for (const auto& [ending, format] : {std::pair{".csv", PoseFormat::kCsv}, {".jsonl", PoseFormat::kJsonLines}}) {
    const TemporaryDirectory directory;
    const std::string path = directory.File("some") + ending;
    std::string text = PoseHeader(format);
    for (const Pose& pose : poses) text += PoseLine(format, pose);
    ASSERT_TRUE(WriteFile(path, text).ok());
    const auto read = ReadPoseFile(path);
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_THAT(read->after_losses, ::testing::ElementsAre(1, 3)) << ending << ": without the ambiguous pose";
  }
}

TEST(PoseReaderTest, ErrorsNameTheLineAndTheCause) {
  const auto message = [](const std::string& text) {
    const absl::Status status = ReadCsv(text).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    return std::string(status.message());
  };
  EXPECT_THAT(message("a,b\n1,2\n"), HasSubstr("some.csv:1: has no column t_us"));
  EXPECT_THAT(message(Csv({SomePose(5), SomePose(5)})), HasSubstr("some.csv:3: its time does not increase"));
  EXPECT_THAT(message(Csv({SomePose(5), SomePose(6, "book")})),
              HasSubstr("some.csv:3: holds poses of cube and of book"));
  EXPECT_THAT(message(absl::StrCat(Csv({SomePose(5)}), "1,2\n")), HasSubstr("some.csv:3: has 2 fields"));
  EXPECT_THAT(message("qw,qz,qy,qx,tz_m,ty_m,tx_m,t_us\n1,0,0,0,3,2,x,7\n"), HasSubstr("\"x\" is not a number"));
  EXPECT_THAT(message("qw,qz,qy,qx,tz_m,ty_m,tx_m,t_us\n1,0,1,0,3,2,1,7\n"), HasSubstr("some.csv:2"));
}

Pose FullPose(int64_t t_us, const std::string& object) {
  Pose pose = SomePose(t_us, object);
  pose.seq = 7;
  pose.state = TrackState::kAmbiguous;
  pose.explained_ratio = 0.625f;
  for (int i = 0; i < 6; ++i) pose.twist[i] = 0.1 * i - 0.3;
  pose.alternatives = {{{ExpSo3({0.0, 0.0, 1.5}), {0.0, 0.25, 2.0}}, -1.5}};
  if (t_us > 5) pose.latest_loss = {-3, LossCause::kBetterPose};
  return pose;
}

TEST(PoseRecordsTest, AllThatAFormatStatesIsRead) {
  const std::vector<Pose> written = {FullPose(5, "cube"), FullPose(5, "book"), FullPose(6, "cube")};
  for (const auto& [ending, format] : {std::pair{".csv", PoseFormat::kCsv}, {".jsonl", PoseFormat::kJsonLines}}) {
    const std::string path = (std::filesystem::path(::testing::TempDir()) / "evpose_records").string() + ending;
    std::string text = PoseHeader(format);
    for (const Pose& pose : written) text += PoseLine(format, pose);
    ASSERT_TRUE(WriteFile(path, text).ok());
    std::vector<Pose> read;
    const auto facts = VisitPoses(path, [&](Pose pose) {
      read.push_back(std::move(pose));
      return absl::OkStatus();
    });
    ASSERT_TRUE(facts.ok()) << facts.status();
    EXPECT_TRUE(facts->has_covariances);
    ASSERT_EQ(read.size(), written.size());
    for (size_t i = 0; i < read.size(); ++i) {
      SCOPED_TRACE(absl::StrCat(path, " ", i));
      EXPECT_EQ(read[i].object_id, written[i].object_id);
      EXPECT_EQ(read[i].t_us, written[i].t_us);
      EXPECT_EQ(read[i].seq, 7u);
      EXPECT_EQ(read[i].state, TrackState::kAmbiguous);
      EXPECT_EQ(read[i].explained_ratio, 0.625f);
      EXPECT_EQ(read[i].twist, written[i].twist);
      EXPECT_EQ(read[i].covariance, written[i].covariance);
      EXPECT_TRUE(read[i].latest_loss == written[i].latest_loss);
      ASSERT_EQ(read[i].alternatives.size(), 1u);
      EXPECT_EQ(read[i].alternatives[0].log_likelihood_ratio, -1.5);
      EXPECT_EQ(read[i].alternatives[0].camera_from_object.translation_m, Eigen::Vector3d(0.0, 0.25, 2.0));
    }
  }
}

TEST(PoseRecordsTest, LossesMayBeAbsentOrOfALaterVersion) {
  std::vector<std::optional<Loss>> losses;
  const auto keep = [&](const FilePose& pose) {
    losses.push_back(pose.latest_loss);
    return absl::OkStatus();
  };
  const std::string columns = "t_us,tx_m,ty_m,tz_m,qx,qy,qz,qw", numbers = "1,1,2,3,0,0,0,1";
  const std::string fields = R"({"t_us":1,"translation_m":[1,2,3],"quaternion_xyzw":[0,0,0,1])";
  EXPECT_TRUE(VisitCsvPoses(columns + "\n" + numbers + "\n", "p.csv", keep).ok());
  EXPECT_TRUE(VisitJsonPoses(fields + "}", "p.jsonl", keep).ok());
  EXPECT_THAT(losses, ::testing::ElementsAre(std::nullopt, std::nullopt));
  losses.clear();
  const std::string header = columns + ",lost_at_us,loss_cause\n";
  EXPECT_TRUE(VisitCsvPoses(header + numbers + ",7,SOMETHING\n", "p.csv", keep).ok());
  EXPECT_TRUE(VisitJsonPoses(fields + R"(,"lost_at_us":7,"loss_cause":"SOMETHING"})", "p.jsonl", keep).ok());
  EXPECT_TRUE(losses.at(0) == (Loss{7, LossCause::kUnknown}) && losses.at(1) == losses[0]);
  EXPECT_EQ(VisitCsvPoses(header + numbers + ",soon,UNCERTAIN\n", "p.csv", keep).status().message(),
            "p.csv:2: lost_at_us: \"soon\" is not a time in microseconds");
  EXPECT_EQ(VisitJsonPoses(fields + R"(,"lost_at_us":"soon"})", "p.jsonl", keep).status().message(),
            "p.jsonl:1: lost_at_us is not a number");
  EXPECT_EQ(VisitJsonPoses(fields + R"(,"lost_at_us":7,"loss_cause":7})", "p.jsonl", keep).status().message(),
            "p.jsonl:1: loss_cause is not a string");
}

TEST(PoseRecordsTest, AQuaternionKeepsItsDigits) {
  // Finds a rotation for which the conversion from quaternion to matrix and back changes the last digits.
  Transform transform;
  Eigen::Quaterniond written = Eigen::Quaterniond::Identity();
  for (int i = 1; transform.Quaternion().coeffs() == written.coeffs(); ++i) {
    ASSERT_LT(i, 1000);
    transform.rotation = ExpSo3({0.1 * i, 0.7, -0.3});
    written = transform.Quaternion();
    transform.rotation = written.toRotationMatrix();
  }
  const std::string numbers =
      absl::StrFormat("%.17g,%.17g,%.17g,%.17g", written.x(), written.y(), written.z(), written.w());
  FilePose read;
  const auto keep = [&](FilePose pose) {
    read = std::move(pose);
    return absl::OkStatus();
  };
  const std::string line = R"({"t_us":1,"translation_m":[1,2,3],"quaternion_xyzw":[)" + numbers + "]}";
  ASSERT_TRUE(VisitJsonPoses(line, "p.jsonl", keep).ok());
  EXPECT_EQ(read.quaternion.coeffs(), written.coeffs());
  read = {};
  ASSERT_TRUE(VisitCsvPoses("t_us,tx_m,ty_m,tz_m,qx,qy,qz,qw\n1,1,2,3," + numbers + "\n", "p.csv", keep).ok());
  EXPECT_EQ(read.quaternion.coeffs(), written.coeffs());
  EXPECT_EQ(read.camera_from_object.rotation, transform.rotation);
  // One of another length is normalised.
  ASSERT_TRUE(VisitJsonPoses(R"({"t_us":1,"translation_m":[1,2,3],"quaternion_xyzw":[0,0,0,1.0005]})", "p", keep).ok());
  EXPECT_EQ(read.quaternion.w(), 1.0);
}

TEST(PoseRecordsTest, JsonNumbersOfAnyFormAreIntegersOrErrors) {
  FilePose read;
  const auto status = [&](const std::string& fields) {
    const std::string line = "{" + fields + R"(,"translation_m":[1,2,3],"quaternion_xyzw":[0,0,0,1]})";
    return std::string(VisitJsonPoses(line, "p",
                                      [&](FilePose pose) {
                                        read = std::move(pose);
                                        return absl::OkStatus();
                                      })
                           .status()
                           .message());
  };
  EXPECT_EQ(status(R"("t_us":16.000018e6,"pose_seq":2.0)"), "");
  EXPECT_EQ(read.t_us, 16'000'018);
  EXPECT_EQ(read.seq, 2u);
  EXPECT_EQ(status(R"("t_us":-9223372036854775808,"pose_seq":18446744073709551615)"), "");
  EXPECT_EQ(read.t_us, std::numeric_limits<int64_t>::min());
  EXPECT_EQ(read.seq, std::numeric_limits<uint64_t>::max());
  for (const char* const number : {"1e300", "-1e300", "1.5", "9223372036854775808", "9.223372036854775808e18"}) {
    EXPECT_THAT(status(absl::StrCat("\"t_us\":", number)), HasSubstr("; it must be an integer from -2^63 to 2^63 - 1"));
  }
  for (const char* const number : {"-1", "-1.0", "0.5", "1e20", "18446744073709551616"}) {
    EXPECT_THAT(status(absl::StrCat("\"t_us\":1,\"pose_seq\":", number)), HasSubstr("; it must be an integer from 0"));
  }
  EXPECT_EQ(status(R"("t_us":1,"explained_ratio":1e300)"), "");
  EXPECT_EQ(read.explained_ratio, std::numeric_limits<float>::max());
}

TEST(PoseRecordsTest, TumHasNoObjectAndIsTracking) {
  const std::string path = (std::filesystem::path(::testing::TempDir()) / "evpose_records.tum").string();
  ASSERT_TRUE(WriteFile(path, "# object_from_camera, timestamp tx ty tz qx qy qz qw\n0.5 1 2 3 0 0 0 1\n").ok());
  Pose read;
  const auto facts = VisitPoses(path, [&](Pose pose) {
    read = std::move(pose);
    return absl::OkStatus();
  });
  ASSERT_TRUE(facts.ok()) << facts.status();
  EXPECT_FALSE(facts->has_covariances);
  EXPECT_EQ(read.t_us, 500'000);
  EXPECT_EQ(read.object_id, "");
  EXPECT_EQ(read.state, TrackState::kTracking);
  EXPECT_EQ(FrameToCamera(facts->transform, {}, path)->Apply(read).camera_from_object.translation_m,
            Eigen::Vector3d(-1, -2, -3));
}

TEST(PoseRecordsTest, ErrorsOfJsonLinesNameLineAndField) {
  const auto message = [](const std::string& text) {
    return std::string(
        VisitJsonPoses(text, "p.jsonl", [](const Pose&) { return absl::OkStatus(); }).status().message());
  };
  const std::string pose = R"("translation_m":[1,2,3],"quaternion_xyzw":[0,0,0,1])";
  EXPECT_EQ(message("{\"t_us\":1," + pose + "}\n"), "");
  EXPECT_EQ(message("\n[1]\n"), "p.jsonl:2: is no JSON object");
  EXPECT_EQ(message("{" + pose + "}"), "p.jsonl:1: has no t_us");
  EXPECT_EQ(message("{\"t_us\":\"1\"," + pose + "}"), "p.jsonl:1: t_us is not a number");
  EXPECT_EQ(message("{\"t_us\":1,\"translation_m\":[1,2],\"quaternion_xyzw\":[0,0,0,1]}"),
            "p.jsonl:1: translation_m is not a list of 3 numbers");
  EXPECT_EQ(message("{\"t_us\":1}"), "p.jsonl:1: has no translation_m and quaternion_xyzw");
  EXPECT_EQ(message("{\"t_us\":1," + pose + ",\"covariance_upper\":[1]}"),
            "p.jsonl:1: covariance_upper is not a list of 21 numbers");
}

}  // namespace
}  // namespace evpose::client
