// SPDX-License-Identifier: Apache-2.0

// Tests WatchEvents with the tracker of the product: no pose depends on watchers.
#include <map>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/models/object_model.h"
#include "server/rpc/watch/watch_events_testing.h"

namespace evpose::server {
namespace {

using Kind = v1::TrackResponse;

// Uses the tracker of the product.
class RealWatchEventsTest : public WatchEventsTest {
 protected:
  RealWatchEventsTest() {
    server_ = Server::Start(Options()).value();
    Use(server_->InProcessChannel());
  }

  // The poses of a session, serialized, without their latencies, which are measured. Half of the events are tracked
  // without a watcher, and the other half with `num_watchers`.
  std::vector<std::string> Track(const v1::CreateSessionRequest& request, const std::vector<Event>& events,
                                 size_t num_watchers) {
    CreatedSession session;
    EXPECT_EQ(Describe(Create(request, &session)), "OK");
    const auto track = Attached(session);
    std::vector<v1::TrackResponse> responses;
    v1::TrackResponse response;
    constexpr size_t kEventsPerChunk = 4000;
    std::map<size_t, std::pair<grpc::ClientContext, EventReader>> watchers;
    uint64_t seq = 0;
    for (size_t begin = 0; begin < events.size(); begin += kEventsPerChunk) {
      const size_t end = std::min(begin + kEventsPerChunk, events.size());
      while (begin > events.size() / 2 && watchers.size() < num_watchers) {
        auto& [context, reader] = watchers[watchers.size()];
        reader = Watch(context, Request(session, 1u << (watchers.size() % 3)));
      }
      track->Events(++seq, Flat64({events.begin() + static_cast<std::ptrdiff_t>(begin),
                                   events.begin() + static_cast<std::ptrdiff_t>(end)}));
      EXPECT_TRUE(track->ReadUntil(Kind::kAck, response, &responses));
    }
    track->End();
    EXPECT_TRUE(track->ReadUntil(Kind::kSummary, response, &responses));
    std::vector<std::string> poses;
    std::map<int64_t, v1::RigidTransform> by_time;
    for (const v1::TrackResponse& one : responses) {
      if (one.has_pose()) {
        v1::Pose pose = one.pose();
        pose.clear_latency();
        by_time[pose.t_us()] = pose.camera_from_object();
        poses.push_back(pose.SerializeAsString());
      }
    }
    for (auto& [number, watcher] : watchers) {
      Shown shown;
      v1::WatchEventsResponse image;
      while (watcher.second->Read(&image)) {
        shown.Add(image.image());
        for (const v1::ObjectOutline& outline : image.image().outlines()) {
          EXPECT_EQ(outline.camera_from_object().SerializeAsString(), by_time[outline.t_us()].SerializeAsString());
          EXPECT_GE(outline.segments_px_size(), 4 * 3) << "three edges of a cube are visible at least";
          EXPECT_EQ(outline.kinds().size() * 4, static_cast<size_t>(outline.segments_px_size()));
        }
      }
      EXPECT_EQ(Describe(watcher.second->Finish()), "OK");
      EXPECT_GT(shown.num_events, events.size() / 3);
      EXPECT_EQ(shown.last.outlines_size(), 1);
    }
    return poses;
  }
};

TEST_F(RealWatchEventsTest, NoPoseDependsOnWatchers) {
  const CameraModel camera = testing::MakeCamera(320, 240, 300.0);
  const RigidTransform start = testing::MakePose({0.02, -0.01, 0.5}, {0.6, 0.5, 0.2});
  Vector6d twist;
  twist << 0.1, -0.1, 0.05, 1.0, -2.0, 0.7;
  testing::IdealEventOptions ideal;
  ideal.duration_us = 150'000;
  const std::vector<Event> events =
      testing::MakeIdealEvents(*testing::MakeCube(0.2), camera, testing::ConstantTwist(start, twist), ideal);
  const std::string cube = ObjectModelToObj(*testing::MakeCube(0.2));
  v1::Model model;
  ASSERT_EQ(Describe(Upload(UploadRequests(cube), &model)), "OK");
  v1::CreateSessionRequest request = CubeSessionRequest(model.name());
  request.mutable_config()->mutable_camera()->set_cx_px(camera.cx_px);
  request.mutable_config()->mutable_camera()->set_cy_px(camera.cy_px);
  v1::RigidTransform& given = *request.mutable_config()->mutable_objects(0)->mutable_initial_camera_from_object();
  const Eigen::Quaterniond rotation(start.rotation);
  given.mutable_rotation()->set_w(rotation.w());
  given.mutable_rotation()->set_x(rotation.x());
  given.mutable_rotation()->set_y(rotation.y());
  given.mutable_rotation()->set_z(rotation.z());
  given.mutable_translation_m()->set_x(start.translation_m.x());
  given.mutable_translation_m()->set_y(start.translation_m.y());
  given.mutable_translation_m()->set_z(start.translation_m.z());
  const std::vector<std::string> without = Track(request, events, 0);
  EXPECT_GT(without.size(), 50u);
  EXPECT_EQ(Track(request, events, 1), without);
  EXPECT_EQ(Track(request, events, 4), without);
}

}  // namespace
}  // namespace evpose::server
