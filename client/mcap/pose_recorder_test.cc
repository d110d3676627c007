// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/pose_recorder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <iterator>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/mcap/mcap_testing.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::UnorderedElementsAre;

std::string RecordingPath(const std::string& name) {
  std::string path = absl::StrCat(::testing::TempDir(), "/pose_recorder_test_", name, ".mcap");
  std::filesystem::remove(path);
  std::filesystem::remove(path + ".partial");
  return path;
}

Pose PoseAt(int64_t t_us, TrackState state, const std::string& id = "part") {
  Pose pose;
  pose.object_id = id;
  pose.t_us = t_us;
  pose.state = state;
  pose.camera_from_object.translation_m = {0.1, 0.2, 1e-6 * static_cast<double>(t_us)};
  return pose;
}

void AddPose(PoseRecorder& recorder, const Pose& pose) { recorder.Add(pose, {pose, kCameraFrame}, "{}"); }

std::vector<TestMessage> OfTopic(const std::vector<TestMessage>& messages, const std::string& topic) {
  std::vector<TestMessage> found;
  std::copy_if(messages.begin(), messages.end(), std::back_inserter(found),
               [&topic](const TestMessage& message) { return message.topic == topic; });
  return found;
}

std::map<std::string, size_t> CountByTopic(const std::vector<TestMessage>& messages) {
  std::map<std::string, size_t> counts;
  for (const TestMessage& message : messages) ++counts[message.topic];
  return counts;
}

std::vector<uint64_t> TimesOf(const std::vector<TestMessage>& messages) {
  std::vector<uint64_t> times;
  for (const TestMessage& message : messages) times.push_back(message.log_time_ns);
  return times;
}

PoseRecorderOptions OnePart(std::optional<int64_t> epoch_ns = 0) {
  PoseRecorderOptions options;
  options.object_ids = {"part"};
  options.epoch_ns = epoch_ns;
  return options;
}

TEST(PoseRecorder, OnlyConfirmedPosesAreMessagesOfPoses) {
  const std::string path = RecordingPath("states");
  auto recorder = PoseRecorder::Open(path, OnePart());
  ASSERT_TRUE(recorder.ok());
  int64_t t_us = 0;
  for (const TrackState state : {TrackState::kInitializing, TrackState::kTracking, TrackState::kDegraded,
                                 TrackState::kAmbiguous, TrackState::kLost, TrackState::kUnknown}) {
    AddPose(**recorder, PoseAt(t_us += 10, state));
  }
  (*recorder)->AddState("part", 70, TrackState::kLost);
  AddPose(**recorder, PoseAt(80, TrackState::kTracking, "another"));  // not recorded in this file
  (*recorder)->AddState("another", 80, TrackState::kLost);
  ASSERT_TRUE((*recorder)->Commit().ok());
  const std::vector<TestMessage> messages = ReadMessages(path);
  for (const char* const topic : {"/tf", "/evpose/part/pose", "/evpose/part/twist"}) {
    EXPECT_THAT(TimesOf(OfTopic(messages, topic)), ElementsAre(20'000, 30'000)) << topic;
  }
  EXPECT_THAT(TimesOf(OfTopic(messages, "/evpose/part/state")),
              ElementsAre(10'000, 20'000, 30'000, 40'000, 50'000, 60'000, 70'000));
  EXPECT_EQ(messages.size(), 13u);
  const TestMessage& lost = messages.back();
  EXPECT_EQ(MessageReader(lost.type, lost.definition, lost.bytes).Text("data"),
            R"({"object_id":"part","t_us":70,"state":"LOST"})");
}

TEST(PoseRecorder, TheSceneHasTheTimeOfTheFirstMessage) {
  const std::string path = RecordingPath("scene");
  PoseRecorderOptions options = OnePart(1'000'000'000);
  options.world_from_camera.emplace("cell", Transform());
  auto recorder = PoseRecorder::Open(path, options);
  (*recorder)->SetCamera({.width_px = 4, .height_px = 2});
  ModelGeometry geometry;
  geometry.vertices_m = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  geometry.faces = {{0, 1, 2}};
  (*recorder)->SetModel("part", geometry);
  (*recorder)->SetModel("another", geometry);
  (*recorder)->Add(SessionHealth{.t_us = 0}, "sessions/1");  // before the first event: no time
  (*recorder)->Add(SessionHealth{.t_us = 5, .decoded_events = 1}, "sessions/1");
  EventImage image = {.to_t_us = 6, .cell_px = 2, .width = 3, .height = 1, .cells = {0}};
  (*recorder)->Add(image, "\x89PNG");
  const Pose pose = PoseAt(7, TrackState::kTracking);
  Pose framed = pose;
  framed.camera_from_object.translation_m = {7, 8, 9};
  (*recorder)->Add(pose, {framed, "cell"}, "{}");
  ASSERT_TRUE((*recorder)->Commit().ok());
  const std::vector<TestMessage> messages = ReadMessages(path);
  std::vector<std::string> topics;
  for (const TestMessage& message : messages) topics.push_back(message.topic);
  EXPECT_THAT(topics, ElementsAre("/tf_static", "/evpose/camera_info", "/evpose/part/model", "/diagnostics",
                                  "/evpose/events/compressed", "/evpose/events/annotations", "/tf", "/evpose/part/pose",
                                  "/evpose/part/twist", "/evpose/part/state"));
  for (size_t i = 0; i < 4; ++i) EXPECT_EQ(messages[i].log_time_ns, 1'000'005'000u);
  const TestMessage world = OfTopic(messages, "/tf_static").at(0);
  const MessageReader world_reader(world.type, world.definition, world.bytes);
  EXPECT_EQ(world_reader.Text("transforms[0].header.frame_id"), "cell");
  EXPECT_EQ(world_reader.Text("transforms[0].child_frame_id"), "evpose_camera");
  const TestMessage moving = OfTopic(messages, "/tf").at(0);
  const MessageReader moving_reader(moving.type, moving.definition, moving.bytes);
  EXPECT_EQ(moving_reader.Text("transforms[0].header.frame_id"), "evpose_camera");
  EXPECT_EQ(moving_reader.Text("transforms[0].child_frame_id"), "part");
  EXPECT_EQ(moving_reader.Number("transforms[0].transform.translation.x"), 0.1);
  const TestMessage in_cell = OfTopic(messages, "/evpose/part/pose").at(0);
  const MessageReader in_cell_reader(in_cell.type, in_cell.definition, in_cell.bytes);
  EXPECT_EQ(in_cell_reader.Text("header.frame_id"), "cell");
  EXPECT_EQ(in_cell_reader.Number("pose.pose.position.x"), 7);
  EXPECT_EQ(in_cell_reader.Number("header.stamp.sec"), 1);
  EXPECT_EQ(in_cell_reader.Number("header.stamp.nanosec"), 7000);
}

TEST(PoseRecorder, ASceneThatArrivesLaterHasTheTimeOfTheFirstMessage) {
  const std::string path = RecordingPath("late_scene");
  auto recorder = PoseRecorder::Open(path, OnePart());
  AddPose(**recorder, PoseAt(1000, TrackState::kTracking));
  AddPose(**recorder, PoseAt(9'000'000, TrackState::kTracking));
  (*recorder)->SetCamera({});
  ASSERT_TRUE((*recorder)->Commit().ok());
  EXPECT_THAT(TimesOf(OfTopic(ReadMessages(path), "/evpose/camera_info")), ElementsAre(1'000'000));
}

TEST(PoseRecorder, TheEpochIsThatOfTheFirstArrival) {
  const std::string path = RecordingPath("arrival");
  absl::Time now = absl::FromUnixSeconds(1'700'000'000);
  PoseRecorderOptions options = OnePart(std::nullopt);
  options.now = [&now] { return now; };
  auto recorder = PoseRecorder::Open(path, options);
  AddPose(**recorder, PoseAt(16'000'000, TrackState::kTracking));
  now += absl::Seconds(5);  // a late arrival does not move the times
  AddPose(**recorder, PoseAt(16'001'000, TrackState::kTracking));
  ASSERT_TRUE((*recorder)->Commit().ok());
  EXPECT_THAT(TimesOf(OfTopic(ReadMessages(path), "/evpose/part/pose")),
              ElementsAre(1'700'000'000'000'000'000, 1'700'000'000'001'000'000));
}

TEST(PoseRecorder, TimesAreLimitedToThoseOfRos) {
  const std::string path = RecordingPath("limits");
  auto recorder = PoseRecorder::Open(path, OnePart(1000));
  for (const int64_t t_us :
       {std::numeric_limits<int64_t>::min(), int64_t{-2}, int64_t{0}, std::numeric_limits<int64_t>::max()}) {
    AddPose(**recorder, PoseAt(t_us, TrackState::kTracking));
  }
  ASSERT_TRUE((*recorder)->Commit().ok());
  EXPECT_THAT(TimesOf(OfTopic(ReadMessages(path), "/evpose/part/pose")),
              ElementsAre(0, 0, 1000, 2'147'483'647'000'000'000));
}

TEST(PoseRecorder, AnyEpochOfARecordingIsAccepted) {
  const std::string path = RecordingPath("epoch_limits");
  for (const auto& [epoch_ns, expected_ns] :
       std::map<int64_t, uint64_t>{{std::numeric_limits<int64_t>::min(), 0},
                                   {std::numeric_limits<int64_t>::max(), 2'147'483'647'000'000'000}}) {
    auto recorder = PoseRecorder::Open(path, OnePart(epoch_ns));
    ASSERT_TRUE(recorder.ok());
    AddPose(**recorder, PoseAt(1000, TrackState::kTracking));
    AddPose(**recorder, PoseAt(-1000, TrackState::kTracking));
    ASSERT_TRUE((*recorder)->Commit().ok());
    EXPECT_THAT(TimesOf(OfTopic(ReadMessages(path), "/evpose/part/pose")), ElementsAre(expected_ns, expected_ns));
  }
}

TEST(PoseRecorder, ContinuesWithTheEpochAndTheSceneOfTheFile) {
  const std::string path = RecordingPath("continued");
  absl::Time now = absl::FromUnixSeconds(1'700'000'000);
  PoseRecorderOptions options = OnePart(std::nullopt);
  options.now = [&now] { return now; };
  uint64_t kept = 0;
  {
    auto recorder = PoseRecorder::Open(path, options, 0);
    (*recorder)->SetCamera({});
    AddPose(**recorder, PoseAt(1000, TrackState::kTracking));
    kept = *(*recorder)->Sync();
    AddPose(**recorder, PoseAt(2000, TrackState::kTracking));
  }
  now += absl::Hours(1);
  auto recorder = PoseRecorder::Open(path, options, kept);
  ASSERT_TRUE(recorder.ok()) << recorder.status();
  (*recorder)->SetCamera({});
  AddPose(**recorder, PoseAt(2000, TrackState::kTracking));
  ASSERT_TRUE((*recorder)->Commit().ok());
  const std::vector<TestMessage> messages = ReadMessages(path);
  EXPECT_THAT(TimesOf(OfTopic(messages, "/evpose/part/pose")),
              ElementsAre(1'700'000'000'000'000'000, 1'700'000'000'001'000'000));
  EXPECT_EQ(CountByTopic(messages)["/evpose/camera_info"], 1u);
}

TEST(PoseRecorder, NamesOfTopics) {
  EXPECT_EQ(NameInRos("part"), "part");
  EXPECT_EQ(NameInRos("left-hand 2"), "left_hand_2");
  EXPECT_EQ(NameInRos("7"), "_7");
  EXPECT_EQ(NameInRos(""), "_");
  const std::string path = RecordingPath("names");
  PoseRecorderOptions options = OnePart();
  options.object_ids = {"a-b", "a_b", "a b"};
  auto recorder = PoseRecorder::Open(path, options);
  for (const std::string& id : options.object_ids) (*recorder)->AddState(id, 0, TrackState::kLost);
  ASSERT_TRUE((*recorder)->Commit().ok());
  EXPECT_THAT(CountByTopic(ReadMessages(path)),
              UnorderedElementsAre(std::pair("/evpose/a_b/state", 1), std::pair("/evpose/a_b_2/state", 1),
                                   std::pair("/evpose/a_b_3/state", 1)));
}

}  // namespace
}  // namespace evpose::client
