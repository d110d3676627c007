// SPDX-License-Identifier: Apache-2.0

// Tests SessionService.WatchEvents through raw stubs.
#include <cmath>

#include "core/base/poll_testing.h"
#include "server/rpc/watch/watch_events_testing.h"

namespace evpose::server {
namespace {

using Kind = v1::TrackResponse;

TEST_F(WatchEventsTest, TheImagesShowAllEventsAndTheOutlines) {
  const CreatedSession session = CreateSession();
  grpc::ClientContext context;
  const EventReader watcher = Watch(context, Request(session));
  const auto track = Attached(session);
  const std::vector<Event> events = SomeEvents(1, 31);
  track->Events(1, Flat64(events));
  track->End();
  EXPECT_EQ(Describe(track->Finish()), "OK");
  Shown shown;
  v1::WatchEventsResponse response;
  while (watcher->Read(&response)) shown.Add(response.image());
  EXPECT_EQ(Describe(watcher->Finish()), "OK") << "the session has ended";
  EXPECT_EQ(shown.num_events, events.size());
  EXPECT_EQ(shown.last.cell_px(), 2u);
  EXPECT_EQ(shown.last.width(), 160u);
  EXPECT_EQ(shown.last.height(), 120u);
  EXPECT_EQ(shown.last.to_t_us(), events.back().t_us);
  EventBitmap expected({320, 240}, 2);
  expected.Add(events);
  const absl::Span<const uint8_t> bytes = expected.bytes();
  EXPECT_EQ(shown.cells, std::string(bytes.begin(), bytes.end()));

  ASSERT_EQ(shown.last.outlines_size(), 1);
  const v1::ObjectOutline& outline = shown.last.outlines(0);
  EXPECT_EQ(outline.object_id(), "cube");
  EXPECT_EQ(outline.state(), v1::TRACK_STATE_TRACKING);
  EXPECT_EQ(outline.camera_from_object().rotation().w(), 1.0);
  EXPECT_EQ(std::vector<float>(outline.segments_px().begin(), outline.segments_px().end()),
            (std::vector<float>{160, 120, 190, 120}));
  EXPECT_EQ(outline.kinds(), std::string("\2"));
  EXPECT_EQ(server_->metrics().event_images.value(), static_cast<uint64_t>(shown.num_images));
  EXPECT_EQ(server_->metrics().skipped_event_images.value(), shown.num_skipped);
}

TEST_F(WatchEventsTest, WatchersThatCannotBeServedReceiveAnError) {
  const CreatedSession session = CreateSession();
  EXPECT_EQ(WatchError({}), "NOT_FOUND SESSION_NOT_FOUND");
  EXPECT_EQ(WatchError(Request(session, 3)), "INVALID_ARGUMENT cell_px");
  EXPECT_EQ(WatchError(Request(session, 8)), "INVALID_ARGUMENT cell_px");
  v1::WatchEventsRequest request = Request(session);
  for (const double rate_hz : {0.0, -1.0, 60.1, std::nan(""), HUGE_VAL}) {
    request.set_max_rate_hz(rate_hz);
    EXPECT_EQ(WatchError(request), "INVALID_ARGUMENT max_rate_hz");
  }
}

TEST_F(WatchEventsTest, ASensorMayHaveTooManyPixelsForSmallCells) {
  v1::CreateSessionRequest create = CreateRequest();
  v1::CameraModel& camera = *create.mutable_config()->mutable_camera();
  camera.set_width_px(4096);
  camera.set_height_px(4096);
  camera.set_fx_px(4096);
  camera.set_fy_px(4096);
  CreatedSession session;
  ASSERT_EQ(Describe(Create(create, &session)), "OK");
  EXPECT_EQ(WatchError(Request(session, 1)), "INVALID_ARGUMENT cell_px");
  grpc::ClientContext context;
  Watch(context, Request(session, 2));
  context.TryCancel();
}

TEST_F(WatchEventsTest, TheOperatorMaySwitchItOff) {
  ServerOptions options = Options();
  options.serves_event_images = false;
  Connect(options);
  EXPECT_EQ(WatchError(Request(CreateSession())), "FAILED_PRECONDITION EVENT_IMAGES_OFF");
}

TEST_F(WatchEventsTest, WatchersCountInTheQuotasOfTheirTenant) {
  ServerOptions options = Options();
  options.tenant.max_watchers = 1;
  Connect(options);
  const CreatedSession session = CreateSession();
  grpc::ClientContext context;
  const EventReader watcher = Watch(context, Request(session));
  EXPECT_EQ(WatchError(Request(session)), "RESOURCE_EXHAUSTED TENANT_QUOTA");
  context.TryCancel();
  EXPECT_EQ(Describe(watcher->Finish()), "CANCELLED");
}

TEST_F(WatchEventsTest, TheMemoryOfImagesIsCharged) {
  const uint64_t before = server_->state().session_memory_bytes;
  const CreatedSession first = CreateSession();
  const uint64_t of_session = server_->state().session_memory_bytes - before;
  {
    grpc::ClientContext context;
    const EventReader watcher = Watch(context, Request(first, 1));
    EXPECT_GT(server_->state().session_memory_bytes, before + of_session + 5 * 320 * 240 / 4);
    context.TryCancel();
    watcher->Finish();
  }
  ASSERT_TRUE(Poll([&] { return server_->state().session_memory_bytes <= before + of_session; }));
  ServerOptions options = Options();
  options.max_session_memory = of_session + 1000;
  Connect(options);
  EXPECT_EQ(WatchError(Request(CreateSession())), "RESOURCE_EXHAUSTED SESSION_MEMORY");
}

TEST_F(WatchEventsTest, ADeletedSessionEndsItsWatchers) {
  const CreatedSession session = CreateSession();
  grpc::ClientContext context;
  const EventReader watcher = Watch(context, Request(session));
  EXPECT_EQ(Describe(Delete(session.name())), "OK");
  EXPECT_EQ(Describe(watcher->Finish()), "NOT_FOUND SESSION_DELETED");
}

TEST_F(WatchEventsTest, AnEndedSessionHasNoImages) {
  const CreatedSession session = CreateSession();
  const auto track = Attached(session);
  track->Events(1, Flat64(SomeEvents(1, 11)));
  track->End();
  EXPECT_EQ(Describe(track->Finish()), "OK");
  EXPECT_EQ(WatchError(Request(session)), "OK");
}

TEST_F(WatchEventsTest, AServerThatDrainsAcceptsNoWatcherAndEndsThoseThatItHas) {
  const CreatedSession session = CreateSession();
  grpc::ClientContext context, drain_context;
  const EventReader watcher = Watch(context, Request(session));
  v1::DrainResponse drained;
  ASSERT_EQ(Describe(admin_->Drain(&drain_context, {}, &drained)), "OK");
  EXPECT_EQ(WatchError(Request(session)), "UNAVAILABLE DRAINING");
  server_->Shutdown(absl::InfiniteDuration());
  EXPECT_EQ(watcher->Finish().error_code(), grpc::StatusCode::UNAVAILABLE);
}

// A reader that reads nothing delays neither the session nor another reader, and receives the events of the images that
// it has missed.
TEST_F(WatchEventsTest, ASlowReaderCostsOnlyItsOwnImages) {
  const CreatedSession session = CreateSession();
  grpc::ClientContext slow_context, quick_context;
  v1::WatchEventsRequest request = Request(session, 1);
  request.set_max_rate_hz(60.0);
  const EventReader slow = Watch(slow_context, request), quick = Watch(quick_context, request);
  const auto track = Attached(session);
  v1::TrackResponse response;
  uint64_t num_events = 0;
  for (uint64_t seq = 1; seq <= 40; ++seq) {
    const auto begin_ms = static_cast<int64_t>(100 * seq);
    const std::vector<Event> events = SomeEvents(begin_ms, begin_ms + 100, 30);
    num_events += events.size();
    track->Events(seq, Flat64(events));
    ASSERT_TRUE(track->ReadUntil(Kind::kAck, response));
  }
  track->End();
  ASSERT_TRUE(track->ReadUntil(Kind::kSummary, response));
  Shown of_quick, of_slow;
  v1::WatchEventsResponse image;
  while (quick->Read(&image)) of_quick.Add(image.image());
  while (slow->Read(&image)) of_slow.Add(image.image());
  EXPECT_EQ(Describe(quick->Finish()), "OK");
  EXPECT_EQ(Describe(slow->Finish()), "OK");
  EXPECT_EQ(of_quick.num_events, num_events);
  EXPECT_EQ(of_slow.num_events, num_events);
  EXPECT_EQ(of_quick.cells, of_slow.cells);
}

}  // namespace
}  // namespace evpose::server
