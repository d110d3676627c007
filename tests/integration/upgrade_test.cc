// SPDX-License-Identifier: Apache-2.0

// Two versions of the server on one Redis: evpose-server and evpose-server-next, which has another version of the
// tracker's state and a further field in every stored message (server/stores/common/next_version_testing.cc). Sessions
// go on, or continue by searching again. Every pose is compared, to the bit, with those of a tracker that is restarted
// after the chunks that the notices name, so that no event can be missing.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <csignal>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/lib/messages/conversion.h"
#include "core/base/temporary_directory_testing.h"
#include "core/models/object_model.h"
#include "core/simulation/simulator.h"
#include "evpose/storage/v1/session.pb.h"
#include "evpose/storage/v1/store.pb.h"
#include "google/protobuf/unknown_field_set.h"
#include "server/rpc/common/conversion.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/tracker_factory.h"
#include "server/stores/common/record_version.h"
#include "server/stores/redis/redis_keys.h"
#include "server/stores/redis/redis_testing.h"
#include "tests/integration/upgrade_testing.h"

namespace evpose {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::SizeIs;

constexpr const char* kThis = EVPOSE_SERVER;
constexpr const char* kNext = EVPOSE_SERVER_NEXT;
// Why a tracker's state cannot be read.
const std::string kNextReadsThis = absl::StrCat("the tracker's state has version ", server::kTrackerStateVersion,
                                                ", this server reads version 1000000");
const std::string kThisReadsNext =
    absl::StrCat("the tracker's state has version 1000000, this server reads version ", server::kTrackerStateVersion);
constexpr int kMaxFieldOfThisVersion = 100;

// The poses and the counts that a session must have.
struct Expected {
  std::vector<std::string> poses;
  uint64_t num_events = 0;
};

class UpgradeTest : public testing::Test {
 protected:
  static constexpr size_t kServers = 3;

  void SetUp() override {
    SimulationOptions options = SimulationPreset("cube", "vga").value();
    options.duration_us = 1'800'000;
    options.sensor.noise_ratio = 0.1;
    ASSERT_TRUE(SimulateToDirectory(options, directory_.path()).ok());
    camera_ = client::LoadCamera(Path("camera.yaml")).value();
    const auto recording = client::Recording::Open(Path("recording.raw")).value();
    for (client::EventChunk chunk = recording->Next().value(); !chunk.bytes.empty(); chunk = *recording->Next()) {
      chunks_.push_back(chunk);
    }
    for (size_t i = 0; i < kServers; ++i) {
      places_.push_back(std::make_unique<ServerPlace>(std::vector<std::string>{
          "--store", redis_.url(), "--log-level", "warning", "--max-load", "0", "--listen", "127.0.0.1:0"}));
    }
  }

  // A client that prefers the server of this number.
  std::unique_ptr<StreamingClient> StartClient(size_t first_server) {
    std::vector<std::string> addresses;
    for (size_t i = 0; i < kServers; ++i) addresses.push_back(places_[(first_server + i) % kServers]->address());
    return std::make_unique<StreamingClient>(absl::StrJoin(addresses, ","), Path("model.obj"), camera_, chunks_);
  }

  // Tracks the recording with a restart of the tracker at each of these places.
  Expected Track(const std::vector<std::pair<size_t, client::TrackingRestarted>>& restarts) {
    using server::SessionPipeline;
    const v1::SessionConfig sent = client::ToProto(
        client::SessionConfig{.camera = camera_, .objects = {{.object_id = "cube", .model = "models/a"}}});
    const server::SessionConfig config = server::FromProto(sent).value();
    const std::vector<std::shared_ptr<const ObjectModel>> models = {
        std::make_shared<const ObjectModel>(LoadObjectModel(Path("model.obj")).value())};
    const server::TrackerFactory make_tracker = server::MakeTrackerFactory();
    auto pipeline = SessionPipeline::Create(config, models, make_tracker).value();
    server::PipelineOutput output;
    size_t next = 0;
    const auto process = [&] { pipeline->Process(chunks_[next++].bytes, output); };
    for (const auto& [num_poses, restart] : restarts) {
      while (next < restart.after_seq) process();
      const server::StreamPosition position = pipeline->SaveState().position;
      while (output.poses.size() < *restart.after_pose_seq) process();  // poses that were stored before their chunk
      output.poses.resize(*restart.after_pose_seq);
      pipeline = SessionPipeline::CreateSearching(config, models, make_tracker).value();
      EXPECT_EQ(pipeline->LoadPosition(position), absl::OkStatus());
      next = restart.after_seq;
    }
    while (next < chunks_.size()) process();
    pipeline->Finish(output);
    Expected expected = {.num_events = pipeline->counts().cd_events};
    for (size_t i = 0; i < output.poses.size(); ++i) {
      const server::StoredPose pose = {.pose_seq = i + 1, .estimate = output.poses[i]};
      expected.poses.push_back(PoseText(client::FromProto(server::ToProto(pose, config)).value()));
    }
    return expected;
  }

  // Checks that the session has processed every event of the recording, and that `poses` are those of a tracker with
  // the restarts that the client was told of.
  void ExpectWhole(const absl::StatusOr<client::TrackSummary>& summary, const StreamingClient& client,
                   const std::vector<std::string>& poses) {
    ASSERT_TRUE(summary.ok()) << summary.status();
    const Expected expected = Track(client.restarts());
    ASSERT_GT(expected.poses.size(), 500u);
    EXPECT_EQ(poses.size(), expected.poses.size());
    EXPECT_TRUE(poses == expected.poses) << "the first different pose: " << FirstDifference(poses, expected.poses);
    EXPECT_EQ(summary->health.decoded_events, expected.num_events);
    EXPECT_EQ(summary->health.processed_bytes, NumBytes());
    EXPECT_EQ(summary->health.poses, expected.poses.size());
    EXPECT_EQ(summary->health.skipped_events, 0u);
    EXPECT_EQ(summary->lost_poses, 0u);
    EXPECT_EQ(summary->sent_chunks, chunks_.size());
  }

  // The stored records of a session, each of which must be readable: the number of those with a field of the next
  // version.
  int NumLaterRecords(const std::string& session) {
    storage::v1::SessionRecord record;
    storage::v1::SessionLifecycle lifecycle;
    ParseStored(session, "record", record);
    ParseStored(session, "lifecycle", lifecycle);
    storage::v1::SessionConfig config;
    EXPECT_TRUE(config.ParseFromString(record.config()));
    return HasLaterField(record) + HasLaterField(lifecycle) + HasLaterField(config) + HasLaterField(config.camera());
  }

  std::string Logs() const {
    std::string logs;
    for (const auto& place : places_) logs += place->log();
    return logs;
  }

  std::string Path(const std::string& name) const { return directory_.path() + "/" + name; }

  const server::RedisServer redis_;
  std::vector<std::unique_ptr<ServerPlace>> places_;
  client::Camera camera_;
  std::vector<client::EventChunk> chunks_;

 private:
  const TemporaryDirectory directory_;

  uint64_t NumBytes() const {
    uint64_t bytes = 0;
    for (const client::EventChunk& chunk : chunks_) bytes += chunk.bytes.size();
    return bytes;
  }

  static size_t FirstDifference(const std::vector<std::string>& a, const std::vector<std::string>& b) {
    const size_t size = std::min(a.size(), b.size());
    return 1 + static_cast<size_t>(std::mismatch(a.begin(), a.begin() + size, b.begin()).first - a.begin());
  }

  void ParseStored(const std::string& session, const std::string& field, google::protobuf::Message& message) const {
    constexpr size_t kChecksumBytes = 4;
    std::string bytes = redis_.Text({"HGET", server::RedisSessionKey(session), field});
    ASSERT_GT(bytes.size(), kChecksumBytes);
    bytes.resize(bytes.size() - kChecksumBytes);
    ASSERT_TRUE(message.ParseFromString(bytes));
  }

  static int HasLaterField(const google::protobuf::Message& message) {
    const auto& unknown = message.GetReflection()->GetUnknownFields(message);
    return unknown.field_count() > 0 && unknown.field(0).number() > kMaxFieldOfThisVersion ? 1 : 0;
  }
};

// All servers are replaced one after another, by the next version and then by this one again, while clients stream.
TEST_F(UpgradeTest, ARollingUpgradeAndItsReturnLoseNothing) {
  for (const auto& place : places_) place->Start(kThis);
  std::vector<std::unique_ptr<StreamingClient>> clients;
  for (size_t i = 0; i < kServers; ++i) clients.push_back(StartClient(i));
  constexpr size_t kReplacements = 2 * kServers;
  const size_t part = chunks_.size() / (kReplacements + 2);
  size_t num_open = 0;
  // Lets all clients send a part of the recording, and waits until each is in the middle of it.
  const auto advance = [&] {
    for (const auto& client : clients) client->Open(num_open + part);
    for (const auto& client : clients) client->AwaitProcessed(num_open);
    num_open += part;
  };
  const auto replace_all = [&](const char* program) {
    for (const auto& place : places_) {
      advance();
      place->End(SIGTERM);
      place->Start(program);
    }
  };
  replace_all(kNext);
  advance();
  clients.push_back(StartClient(0));  // creates a session, which the earlier version then reads
  clients.back()->Open(num_open);
  clients.back()->AwaitProcessed(0);
  EXPECT_EQ(NumLaterRecords(clients.front()->session().name), 1) << "the lifecycle record";
  EXPECT_EQ(NumLaterRecords(clients.back()->session().name), 4);
  replace_all(kThis);

  for (const auto& client : clients) {
    SCOPED_TRACE(client->session().name);
    const auto& summary = client->Finish();
    ExpectWhole(summary, *client, client->poses());
    EXPECT_GT(client->num_outages(), 0);
    EXPECT_EQ(client->read_status(), absl::OkStatus());
    EXPECT_TRUE(client->read_poses() == client->poses());
    EXPECT_EQ(client->read_skipped(), 0u);
    // All poses of the servers before were stored: none is computed again.
    for (const auto& [num_poses, restart] : client->restarts()) EXPECT_EQ(*restart.after_pose_seq, num_poses);
    const bool is_late = client == clients.back();
    std::vector<std::string> details;
    for (const auto& [num_poses, restart] : client->restarts()) details.push_back(restart.detail);
    EXPECT_THAT(details, Contains(kThisReadsNext));
    if (!is_late) {
      EXPECT_THAT(details, Contains(kNextReadsThis));
    }
    EXPECT_EQ(NumLaterRecords(client->session().name), is_late ? 3 : 0) << "an earlier server keeps no later field";
  }
  for (const auto& place : places_) place->End(SIGTERM);
  for (const auto& client : clients) {
    const std::string line = "tracker_state_unreadable session=" + client->session().name;
    EXPECT_THAT(Logs(), HasSubstr(line));
  }
  EXPECT_THAT(Logs(), testing::Not(HasSubstr("session_not_resumed")));
}

// A server that is killed has sent poses that are not stored. The next version computes others from the same events.
TEST_F(UpgradeTest, PosesThatAKilledServerHadNotStoredAreReplaced) {
  places_[0]->Start(kThis);
  places_[1]->Start(kNext);
  const auto client = StartClient(0);
  client->AtPose(300, [this] { redis_.Signal(SIGSTOP); });
  // Far more than the poses of the commit that was sent before or after Redis stopped, and is written when it
  // continues.
  client->AtPose(1100, [this] {
    places_[0]->End(SIGKILL);
    redis_.Signal(SIGCONT);
  });
  const auto& summary = client->Finish();
  ASSERT_THAT(client->restarts(), SizeIs(1)) << summary.status();
  const auto& [num_poses, restart] = client->restarts()[0];
  EXPECT_EQ(restart.detail, kNextReadsThis);
  ASSERT_TRUE(restart.after_pose_seq.has_value());
  ASSERT_GT(num_poses, *restart.after_pose_seq) << "poses must have been sent that were not stored";
  // Up to the last stored pose, the poses are those of the first tracker; later ones are those of the second tracker.
  std::vector<std::string> poses = client->poses();
  poses.erase(poses.begin() + static_cast<ptrdiff_t>(*restart.after_pose_seq), poses.begin() + num_poses);
  ExpectWhole(summary, *client, poses);
  // Those that were replaced were the poses of an undisturbed run.
  const std::vector<std::string> undisturbed = Track({}).poses;
  EXPECT_TRUE(std::equal(client->poses().begin(), client->poses().begin() + num_poses, undisturbed.begin()));
  // A reader receives no number twice, and none is missing.
  EXPECT_EQ(client->read_status(), absl::OkStatus());
  EXPECT_EQ(client->read_skipped(), 0u);
  EXPECT_EQ(client->read_poses().size(), poses.size());
}

}  // namespace
}  // namespace evpose
