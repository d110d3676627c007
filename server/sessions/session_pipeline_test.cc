// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_pipeline.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "core/base/byte_order.h"
#include "server/runtime/errors.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

std::unique_ptr<SessionPipeline> MakePipeline(const SessionConfig& config) {
  return SessionPipeline::Create(config, std::vector<std::shared_ptr<const ObjectModel>>(config.objects.size()),
                                 FakeTrackers())
      .value();
}

// Everything that comes out, in its order.
std::string TrackInChunks(const SessionConfig& config, const std::string& bytes, size_t chunk) {
  const auto pipeline = MakePipeline(config);
  std::ostringstream out;
  const auto print = [&out](PipelineOutput& output) {
    size_t next_change = 0;
    for (size_t i = 0; i <= output.poses.size(); ++i) {
      for (; next_change < output.state_changes.size() && output.state_changes[next_change].num_poses_before == i;
           ++next_change) {
        const ObjectStateChange& change = output.state_changes[next_change];
        out << "object " << change.object_index << " at " << change.t_us << " " << TrackStateName(change.state) << "\n";
      }
      if (i == output.poses.size()) break;
      const PoseEstimate& pose = output.poses[i];
      out << "pose of " << pose.object_index << " at " << pose.t_us << " "
          << pose.camera_from_object.translation_m.transpose() << "\n";
    }
    output.clear();
  };
  PipelineOutput output;
  for (size_t begin = 0; begin < bytes.size(); begin += chunk) {
    const size_t size = std::min(chunk, bytes.size() - begin);
    pipeline->Process({reinterpret_cast<const uint8_t*>(bytes.data()) + begin, size}, output);
    print(output);
  }
  pipeline->Finish(output);
  print(output);
  return out.str();
}

std::string EventfulStream() {
  std::vector<Event> events = SomeEvents(5, 40);
  events.push_back({40'100, 0, 0, 1});  // lost
  for (const Event& event : SomeEvents(41, 44)) events.push_back(event);
  for (const Event& event : SomeEvents(900, 905)) events.push_back(event);  // after a silence
  return Flat64(events);
}

TEST(SessionPipelineTest, OutputDoesNotDependOnTheChunking) {
  for (const auto& ids : std::vector<std::vector<std::string>>{{"one"}, {"a", "b", "c"}}) {
    const SessionConfig config = SomeConfig(ids);
    const std::string bytes = EventfulStream();
    const std::string whole = TrackInChunks(config, bytes, bytes.size());
    EXPECT_THAT(whole, testing::HasSubstr("object 0 at 41000 LOST"));
    for (size_t chunk = 1; chunk < 200; ++chunk) {
      ASSERT_EQ(TrackInChunks(config, bytes, chunk), whole) << "in chunks of " << chunk << " bytes";
    }
  }
}

TEST(SessionPipelineTest, PosesAreThoseOfTheEvents) {
  const auto pipeline = MakePipeline(SomeConfig());
  const std::string bytes = Flat64({{5000, 10, 20, 1}, {5100, 30, 40, 0}, {6000, 7, 7, 0}});
  PipelineOutput output;
  pipeline->Process(AsBytes(bytes), output);
  ASSERT_EQ(output.poses.size(), 1u);
  EXPECT_EQ(output.poses[0].t_us, 5500);
  EXPECT_EQ(output.poses[0].camera_from_object.translation_m, Eigen::Vector3d(2, 40, 60));
  EXPECT_EQ(pipeline->counts().cd_events, 3u);
  EXPECT_EQ(pipeline->now_us(), 6000);
}

TEST(SessionPipelineTest, AResetPoseIsReportedAsAChangeOfState) {
  SessionConfig config = SomeConfig();
  config.objects[0].initial_camera_from_object.reset();
  const auto pipeline = MakePipeline(config);
  PipelineOutput output;
  const auto feed = [&](const std::vector<Event>& events) {
    const std::string bytes = Flat64(events);
    pipeline->Process(AsBytes(bytes), output);
  };
  feed(SomeEvents(5, 8));
  EXPECT_TRUE(output.poses.empty()) << "no pose is reported before the first pose is known";
  pipeline->ResetPose(0, RigidTransform());
  feed(SomeEvents(8, 10));
  ASSERT_EQ(output.state_changes.size(), 1u);
  EXPECT_EQ(output.state_changes[0].state, TrackState::kTracking);
  EXPECT_EQ(output.state_changes[0].t_us, 8000);
  EXPECT_FALSE(output.poses.empty());
}

TEST(SessionPipelineTest, TheErrorOfTheTrackerIsThatOfThePipeline) {
  const TrackerFactory refuse = [](const auto&, const auto&) -> absl::StatusOr<std::unique_ptr<Tracker>> {
    return InvalidField("config.objects[0]", "the model has no line");
  };
  const auto pipeline = SessionPipeline::Create(SomeConfig(), {nullptr}, refuse);
  EXPECT_EQ(pipeline.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(GetErrorDetails(pipeline.status()).field, "config.objects[0]");
  EXPECT_THAT(std::string(pipeline.status().message()), testing::HasSubstr("the model has no line"));
}

TEST(SessionPipelineTest, RefusesASensorThatTheEncodingCannotAddress) {
  SessionConfig config = SomeConfig();
  config.encoding = Encoding::kEvt3;
  config.camera.width_px = 5000;
  const auto pipeline = SessionPipeline::Create(config, {nullptr}, FakeTrackers());
  EXPECT_EQ(GetErrorDetails(pipeline.status()).field, "config.camera");
}

}  // namespace
}  // namespace evpose::server
