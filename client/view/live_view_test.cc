// SPDX-License-Identifier: Apache-2.0

// The view on a session of a real server, which is ended and started again.
#include "client/view/live_view.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <condition_variable>
#include <map>
#include <mutex>
#include <numbers>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/lib/interrupted_server_testing.h"
#include "client/lib/messages/core_types.h"
#include "client/lib/stalled_server_testing.h"
#include "client/view/outbox_reader_testing.h"
#include "client/view/recordings_testing.h"
#include "core/base/temporary_directory_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "server/rpc/server.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

constexpr int64_t kPeriodUs = 200'000;  // of the motion
constexpr int64_t kChunkUs = 1'000;
constexpr char kCubeObj[] =
    "v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\n"
    "f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

RigidTransform CubePose(double t_s) {
  const double angle = 2.0 * std::numbers::pi * t_s / (1e-6 * kPeriodUs);
  return testing::MakePose({0.01 * std::sin(angle), 0.01 * std::cos(angle), 0.5},
                           {0.5, 0.4 + 0.02 * std::sin(angle), 0.1});
}

class LiveViewTest : public ::testing::Test {
 protected:
  void SetUp() override {
    StartServer("127.0.0.1:0");
    address_ = absl::StrCat("127.0.0.1:", server_->port());
    auto client = Client::Connect(address_);
    ASSERT_TRUE(client.ok()) << client.status();
    client_ = std::move(*client);
    const std::string obj = kCubeObj;
    UploadOptions upload;
    upload.metres_per_unit = 0.05;
    upload.file_name = "cube.obj";
    const auto model = client_->UploadModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, upload);
    ASSERT_TRUE(model.ok()) << model.status();
    SessionConfig config;
    config.camera = FromCore(camera_);
    TrackedObject object;
    object.object_id = "cube";
    object.model = model->name;
    object.initial_camera_from_object = FromCore(CubePose(0.0));
    config.objects = {object};
    auto session = client_->CreateSession(config);
    ASSERT_TRUE(session.ok()) << session.status();
    session_ = *session;
    source_ = std::make_unique<LiveSource>(*client_, address_, "", frame_);
  }
  void TearDown() override {
    view_.reset();
    is_done_ = true;
    if (tracker_.joinable()) tracker_.join();
  }

  void StartServer(const std::string& address) {
    server::ServerOptions options;
    options.listen_address = address;
    options.store = {.store = "sqlite", .data_dir = directory_.path()};
    auto server = server::Server::Start(options);
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = std::move(*server);
  }

  // Feeds the session with a moving cube until the end of the test.
  void Feed() {
    tracker_ = std::thread([this] {
      testing::IdealEventOptions ideal;
      ideal.duration_us = kPeriodUs;
      const std::vector<Event> period = testing::MakeIdealEvents(*testing::MakeCube(0.1), camera_, CubePose, ideal);
      auto encoder = MakeEventEncoder(Encoding::kEvt3, kTestSensor);
      int64_t begin_us = 0;
      size_t next = 0;
      const auto source = [&]() -> absl::StatusOr<EventChunk> {
        EventChunk chunk;
        if (is_done_) return chunk;
        std::vector<Event> events;
        begin_us += kChunkUs;
        for (;; next = 0, period_begin_us_ += kPeriodUs) {
          for (; next < period.size() && period_begin_us_ + period[next].t_us < begin_us; ++next) {
            events.push_back(period[next]);
            events.back().t_us += period_begin_us_;
          }
          if (next < period.size()) break;
        }
        chunk.t_last_us = begin_us;
        EXPECT_TRUE((*encoder)->Encode(events, chunk.bytes).ok());
        EXPECT_TRUE((*encoder)->EncodeTime(begin_us, chunk.bytes).ok());
        return chunk;
      };
      const auto summary = client_->Track(session_, source, {});
      EXPECT_TRUE(summary.ok()) << summary.status();
    });
  }

  const TemporaryDirectory directory_;
  const CameraModel camera_ = testing::MakeCamera(kTestSensor.width_px, kTestSensor.height_px, 600.0);
  std::unique_ptr<server::Server> server_;
  std::string address_;
  std::unique_ptr<Client> client_;
  Session session_;
  const PoseFrame frame_ = PoseFrame::WorldFromObject({.translation_m = {0.0, 0.0, 100.0}}, "base");
  OutboxReader reader_;
  std::unique_ptr<LiveSource> source_;
  std::unique_ptr<PageView> view_;
  std::atomic<bool> is_done_ = false;
  int64_t period_begin_us_ = 0;
  std::thread tracker_;
};

TEST_F(LiveViewTest, ShowsASessionFromTheList) {
  view_ = source_->Open(reader_.outbox());
  EXPECT_EQ(reader_.Read().header["mode"], "live");
  const nlohmann::json list = reader_.ReadUntil("sessions").header["sessions"];
  ASSERT_EQ(list.size(), 1u);
  EXPECT_EQ(list[0]["name"], session_.name);
  EXPECT_EQ(list[0]["objects"], nlohmann::json({"cube"}));
  Feed();
  ASSERT_TRUE(view_->Handle(OpenRequest{session_.name}).ok());
  const nlohmann::json scene = reader_.ReadUntil("scene").header;
  EXPECT_EQ(scene["session"], session_.name);
  EXPECT_EQ(scene["camera"]["fx_px"], 600.0);
  EXPECT_EQ(scene["objects"][0]["model"], "cube.obj");
  EXPECT_NEAR(scene["objects"][0]["diameter_m"].get<double>(), 0.1 * std::sqrt(3.0), 1e-6);
  EXPECT_EQ(scene["recording"], nullptr);
  EXPECT_EQ(scene["frame"]["transform"], "base_from_object");
  EXPECT_EQ(scene["frame"]["camera"]["p"], nlohmann::json({0.0, 0.0, 100.0}));
  std::map<std::string, ReceivedMessage> messages;
  while (!messages.contains("geometry") || !messages.contains("poses") || !messages.contains("health") ||
         !messages.contains("state") || !messages.contains("image") || messages["image"].header["outlines"].empty()) {
    ReceivedMessage message = reader_.Read();
    const std::string type = message.type();
    ASSERT_NE(type, "end") << message.header;
    messages[type] = std::move(message);
  }
  EXPECT_EQ(messages["geometry"].sections.at(1).size(), 12 * (3 * sizeof(uint32_t)));
  EXPECT_EQ(messages["poses"].header["object"], "cube");
  EXPECT_NEAR(messages["poses"].header["poses"][0]["p"][2], 100.0 + CubePose(0.0).translation_m.z(), 0.1);
  EXPECT_GT(messages["image"].header["events"], 0);
  EXPECT_EQ(messages["image"].header["width"], kTestSensor.width_px / 2);
  EXPECT_EQ(messages["image"].header["outlines"][0]["object"], "cube");
  EXPECT_GT(messages["image"].header["outlines"][0]["segments"], 6);
  // Images with larger cells follow.
  ASSERT_TRUE(view_->Handle(ImageSettings{10.0, 4, 60.0}).ok());
  while (reader_.ReadUntil("image").header["cell_px"] != 4) {
  }
}

TEST_F(LiveViewTest, SurvivesAServerThatIsRestarted) {
  Feed();
  source_ = std::make_unique<LiveSource>(*client_, address_, session_.name);
  view_ = source_->Open(reader_.outbox());
  reader_.ReadUntil("image");
  server_.reset();
  const nlohmann::json lost = reader_.ReadUntil("notice").header;
  EXPECT_EQ(lost["level"], "error");
  EXPECT_THAT(lost["text"].get<std::string>(), HasSubstr(absl::StrCat("the connection to ", address_, " is lost")));
  StartServer(address_);
  nlohmann::json again = reader_.ReadUntil("notice").header;
  while (again["level"] == "error") again = reader_.ReadUntil("notice").header;
  EXPECT_EQ(again["text"], absl::StrCat("connected to ", address_, " again"));
  reader_.ReadUntil("image");
}

TEST_F(LiveViewTest, TheEndOfTheSessionIsShown) {
  source_ = std::make_unique<LiveSource>(*client_, address_, session_.name);
  view_ = source_->Open(reader_.outbox());
  reader_.ReadUntil("health");
  ASSERT_TRUE(client_->DeleteSession(session_.name).ok());
  EXPECT_THAT(reader_.ReadUntil("end").header["reason"].get<std::string>(), HasSubstr(session_.name));
}

TEST_F(LiveViewTest, APageThatComesBackDuringAnOutageShowsTheSessionAfterwards) {
  Feed();
  source_ = std::make_unique<LiveSource>(*client_, address_, session_.name);
  server_.reset();
  view_ = source_->Open(reader_.outbox());
  const nlohmann::json lost = reader_.ReadUntil("notice").header;
  EXPECT_EQ(lost["level"], "error");
  EXPECT_THAT(lost["text"].get<std::string>(), HasSubstr(absl::StrCat("the connection to ", address_, " is lost")));
  StartServer(address_);
  EXPECT_EQ(reader_.ReadUntil("scene").header["session"], session_.name);
  reader_.ReadUntil("image");
}

TEST_F(LiveViewTest, APageThatComesBackAfterTheSessionShowsItsEnd) {
  source_ = std::make_unique<LiveSource>(*client_, address_, session_.name);
  ASSERT_TRUE(client_->DeleteSession(session_.name).ok());
  view_ = source_->Open(reader_.outbox());
  EXPECT_THAT(reader_.ReadUntil("end").header["reason"].get<std::string>(), HasSubstr(session_.name));
}

TEST_F(LiveViewTest, ASessionThatDoesNotExistIsANoticeAndTheList) {
  view_ = source_->Open(reader_.outbox());
  reader_.ReadUntil("sessions");
  ASSERT_TRUE(view_->Handle(OpenRequest{"sessions/other"}).ok());
  std::map<std::string, ReceivedMessage> messages;
  while (!messages.contains("sessions") || !messages.contains("notice") || !messages.contains("end")) {
    ReceivedMessage message = reader_.Read();
    messages[message.type()] = message;
  }
  EXPECT_THAT(messages["notice"].header["text"].get<std::string>(), HasSubstr("sessions/other"));
  EXPECT_EQ(view_->Handle(SeekRequest{0}).code(), absl::StatusCode::kInvalidArgument);
}

TEST(InterruptedServerTest, TheCallsForTheModelsAreRepeated) {
  InterruptedServer server({});
  OutboxReader reader;
  LiveSource source(server.client(), "test server", "sessions/1");
  const std::unique_ptr<PageView> view = source.Open(reader.outbox());
  const nlohmann::json scene = reader.ReadUntil("scene").header;
  EXPECT_EQ(scene["objects"][0]["model"], "cube.obj");
  EXPECT_EQ(scene["objects"][0]["diameter_m"], 3.0);
  EXPECT_EQ(reader.ReadUntil("geometry").header["diameter_m"], 3.0);
}

TEST(InterruptedServerTest, AModelThatTheServerHasNotSeenHasTheSizeOfItsVertices) {
  InterruptedServer server({.knows_model = false});
  OutboxReader reader;
  LiveSource source(server.client(), "test server", "sessions/1");
  const std::unique_ptr<PageView> view = source.Open(reader.outbox());
  const nlohmann::json scene = reader.ReadUntil("scene").header;
  EXPECT_EQ(scene["objects"][0]["model"], "models/1");
  EXPECT_EQ(scene["objects"][0]["diameter_m"], 0.0);
  EXPECT_EQ(reader.ReadUntil("geometry").header["diameter_m"], 5.0);
}

TEST(StalledServerTest, AnotherSessionAndTheEndOfThePageCancelTheCalls) {
  std::mutex mutex;
  std::condition_variable changed;
  std::vector<std::string> calls;
  StalledServer server([&](const std::string& method) {
    const std::lock_guard lock(mutex);
    calls.push_back(method);
    changed.notify_all();
  });
  const auto wait_for_calls = [&](size_t count) {
    std::unique_lock lock(mutex);
    changed.wait(lock, [&] { return calls.size() == count; });
  };
  OutboxReader reader;
  LiveSource source(server.client(), "test server", "");
  std::unique_ptr<PageView> view = source.Open(reader.outbox());
  EXPECT_EQ(reader.Read().type(), "hello");
  wait_for_calls(1);
  for (const size_t count : {2, 3}) {
    ASSERT_TRUE(view->Handle(OpenRequest{"sessions/1"}).ok());
    wait_for_calls(count);
  }
  view.reset();
  EXPECT_THAT(calls, ::testing::ElementsAre("ListSessions", "GetSession", "GetSession"));
  EXPECT_FALSE(reader.outbox()->Next()) << "a call that ends with its deadline would be a notice";
}

}  // namespace
}  // namespace evpose::client
