// SPDX-License-Identifier: Apache-2.0
#include "client/view/recorded_poses.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/core_types.h"
#include "client/view/page_client_testing.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/estimation/ideal_events_testing.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// The poses of a file that states losses, if `has_losses` is true.
RecordedPoses Recorded(const std::vector<Pose>& poses, bool has_losses) {
  RecordedPoses recorded;
  for (const Pose& pose : poses) EXPECT_TRUE(recorded.Add(pose).ok());
  recorded.Finish(has_losses);
  return recorded;
}

// The state messages of poses, as "time state reason".
std::vector<std::string> StatesOf(const RecordedPoses& recorded) {
  PageOutbox::Prepared frames;
  recorded.AppendFrames("object", /*is_truth=*/false, PoseFrame(), frames);
  std::vector<std::string> states;
  for (const PageOutbox::Frame& frame : frames) {
    const nlohmann::json message = nlohmann::json::parse(frame.bytes);
    if (message["type"] != "state") continue;
    states.push_back(absl::StrCat(message["t_us"].get<int64_t>(), " ", message["state"].get<std::string>(), " ",
                                  message["reason"].get<std::string>()));
  }
  return states;
}

Pose PoseAt(int64_t t_us, std::optional<Loss> latest_loss = std::nullopt) {
  Pose pose;
  pose.object_id = "object";
  pose.t_us = t_us;
  pose.camera_from_object.translation_m = {1e-6 * static_cast<double>(t_us), 0.0, 1.0};
  pose.state = TrackState::kTracking;
  pose.latest_loss = latest_loss;
  return pose;
}

TEST(RecordedPosesTest, LossesHaveTheCausesOfTheFile) {
  const Loss given{5'000, LossCause::kContradicted}, first{21'000, LossCause::kOutOfView};
  const Loss second{300'000, LossCause::kBetterPose}, outside{420'000, LossCause::kUncertain};
  // A pose that was given was rejected before the first one. The object was found again at once after the first loss.
  // Before 500 ms there is a gap without a loss. The last loss is not between its poses.
  const RecordedPoses recorded =
      Recorded({PoseAt(10'000, given), PoseAt(20'000, given), PoseAt(30'000, first), PoseAt(40'000, first),
                PoseAt(400'000, second), PoseAt(500'000, second), PoseAt(510'000, outside)},
               /*has_losses=*/true);
  EXPECT_THAT(StatesOf(recorded), ElementsAre("5000 lost contradicted", "10000 tracking ",                         //
                                              "21000 lost out of view; no pose for 0.010 s", "30000 tracking ",    //
                                              "300000 lost better pose; no pose for 0.360 s", "400000 tracking ",  //
                                              "500001 lost uncertain; no pose for 0.010 s", "510000 tracking "));
  EXPECT_TRUE(recorded.At(15'000));
  for (const int64_t t_us : {25'000, 350'000, 450'000, 505'000}) EXPECT_FALSE(recorded.At(t_us)) << t_us;
}

TEST(RecordedPosesTest, AFileWithoutLossesHasThemInItsGaps) {
  const RecordedPoses recorded =
      Recorded({PoseAt(10'000), PoseAt(20'000), PoseAt(30'000), PoseAt(130'000)}, /*has_losses=*/false);
  EXPECT_THAT(StatesOf(recorded), ElementsAre("10000 tracking ", "30001 lost no pose for 0.100 s", "130000 tracking "));
  EXPECT_FALSE(recorded.At(80'000));
}

// evpose watch --max-rate-hz 10 writes such files.
TEST(RecordedPosesTest, FilesOfALowRateHaveNoLossBetweenTheirPoses) {
  const TemporaryDirectory directory;
  for (const auto& [ending, format] :
       {std::pair{".tum", PoseFormat::kTum}, {".csv", PoseFormat::kCsv}, {".jsonl", PoseFormat::kJsonLines}}) {
    const std::string path = directory.File("poses") + ending;
    std::string text = PoseHeader(format);
    const Loss loss{2'050'000, LossCause::kContradicted};
    for (int64_t t_us = 1'000'000; t_us <= 3'000'000; t_us += 100'000) {
      text += PoseLine(format, PoseAt(t_us, t_us > loss.t_us ? std::optional(loss) : std::nullopt));
    }
    ASSERT_TRUE(WriteFile(path, text).ok());
    const auto poses = ReadRecordedPoses(path, {"object"});
    ASSERT_TRUE(poses.ok()) << poses.status();
    const RecordedPoses& recorded = poses->at("object");
    const bool has_losses = format != PoseFormat::kTum;
    if (has_losses) {
      EXPECT_THAT(StatesOf(recorded), ElementsAre("1000000 tracking ", "2050000 lost contradicted; no pose for 0.100 s",
                                                  "2100000 tracking "));
    } else {
      EXPECT_THAT(StatesOf(recorded), ElementsAre("1000000 tracking "));
    }
    for (const int64_t t_us : {1'050'000, 1'990'000, 2'100'000, 2'110'000}) {
      const auto pose = recorded.At(t_us);
      ASSERT_TRUE(pose) << ending << " " << t_us;
      EXPECT_NEAR(pose->translation_m.x(), 1e-6 * static_cast<double>(t_us), 1e-9);
    }
    EXPECT_EQ(recorded.At(2'080'000).has_value(), !has_losses) << ending << ": the object was lost";
  }
}

TEST(RecordedPosesTest, PosesOfOneHertzAreNotInterpolated) {
  std::vector<Pose> poses;
  for (int64_t t_us = 1'000'000; t_us <= 5'000'000; t_us += 1'000'000) poses.push_back(PoseAt(t_us));
  for (const bool has_losses : {false, true}) {
    const RecordedPoses recorded = Recorded(poses, has_losses);
    EXPECT_THAT(StatesOf(recorded), ElementsAre("1000000 tracking "));
    EXPECT_TRUE(recorded.At(3'000'000));
    EXPECT_FALSE(recorded.At(3'100'000)) << "the object may have turned around";
  }
}

TEST(RecordedPosesTest, AnotherObjectIsAnErrorWithAdvice) {
  const TemporaryDirectory directory;
  Pose pose;
  pose.t_us = 5;
  std::string text = PoseHeader(PoseFormat::kCsv);
  for (const char* const id : {"left", "right"}) {
    pose.object_id = id;
    text += PoseLine(PoseFormat::kCsv, pose);
  }
  const std::string path = directory.File("poses.csv");
  ASSERT_TRUE(WriteFile(path, text).ok());
  const auto both = ReadRecordedPoses(path, {"left", "right"});
  ASSERT_TRUE(both.ok()) << both.status();
  EXPECT_EQ(both->at("left").trajectory().size(), 1u);
  EXPECT_EQ(both->at("right").trajectory().size(), 1u);
  const absl::Status status = ReadRecordedPoses(path, {"object"}).status();
  EXPECT_THAT(status.message(), HasSubstr(path + ":3: holds a pose of the object \"right\""));
  EXPECT_THAT(status.message(), HasSubstr("give --object ID=MODEL"));
  EXPECT_EQ(ReadRecordedPoses(directory.File("{object}.tum"), {"left"}).status().code(), absl::StatusCode::kNotFound);
}

TEST(RecordedPosesTest, PosesAreSentWithTheDigitsOfTheirFile) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("poses.jsonl");
  std::string text;
  std::vector<nlohmann::json> written;
  for (int i = 0; i < 100; ++i) {
    Pose pose;
    pose.object_id = "object";
    pose.t_us = i;
    pose.camera_from_object = FromCore(testing::MakePose({0.01 * i, 0.0, 0.5}, {0.5 + i, 0.4, 0.1}));
    const std::string line = PoseLine(PoseFormat::kJsonLines, pose);
    text += line;
    written.push_back(nlohmann::json::parse(line));
  }
  ASSERT_TRUE(WriteFile(path, text).ok());
  const auto poses = ReadRecordedPoses(path, {"object"});
  ASSERT_TRUE(poses.ok()) << poses.status();
  PageOutbox::Prepared frames;
  poses->at("object").AppendFrames("object", /*is_truth=*/true, PoseFrame(), frames);
  ASSERT_EQ(frames.size(), 1u);
  const nlohmann::json sent = ParseFrame(frames[0].bytes, false).header["poses"];
  ASSERT_EQ(sent.size(), written.size());
  for (size_t i = 0; i < sent.size(); ++i) {
    const nlohmann::json& xyzw = written[i]["quaternion_xyzw"];
    EXPECT_EQ(sent[i]["q"], nlohmann::json({xyzw[3], xyzw[0], xyzw[1], xyzw[2]}));
    EXPECT_EQ(sent[i]["p"], written[i]["translation_m"]);
  }
}

TEST(RecordedPosesTest, ManyPosesAreThinnedForThePage) {
  RecordedPoses poses;
  constexpr int kPoses = 100'000;
  for (int i = 0; i < kPoses; ++i) {
    Pose pose;
    pose.t_us = i;
    ASSERT_TRUE(poses.Add(pose).ok());
  }
  EXPECT_FALSE(poses.Add(Pose()).ok()) << "its time does not increase";
  EXPECT_EQ(poses.trajectory().size(), static_cast<size_t>(kPoses));
  PageOutbox::Prepared frames;
  poses.AppendFrames("object", /*is_truth=*/true, PoseFrame(), frames);
  std::vector<int64_t> sent;
  for (const PageOutbox::Frame& frame : frames) {
    const ReceivedMessage message = ParseFrame(frame.bytes, false);
    for (const nlohmann::json& pose : message.header["poses"]) sent.push_back(pose["t_us"]);
  }
  EXPECT_LE(sent.size(), RecordedPoses::kMaxSent);
  EXPECT_GE(sent.size(), RecordedPoses::kMaxSent / 2);
  for (size_t i = 0; i < sent.size(); ++i) ASSERT_EQ(sent[i], static_cast<int64_t>(8 * i));
}

}  // namespace
}  // namespace evpose::client
