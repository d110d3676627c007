// SPDX-License-Identifier: Apache-2.0

// Tests that sessions survive the loss of the store's master: SIGKILL of the Redis master at random numbers of poses in
// the middle of a stream. Every trajectory must be identical to that of an undisturbed run. EVPOSE_KILLS sets the
// number of kills, EVPOSE_DOWN_AFTER_MS the time after which the Sentinels replace a master that does not respond
// (tests/bench/survival.sh: 50 and 5000). Also tests that nothing is lost silently when a replica that lacks
// acknowledged commits becomes the master.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdio>
#include <functional>
#include <ios>
#include <mutex>
#include <optional>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "absl/time/time.h"
#include "client/lib/messages/conversion.h"
#include "core/base/poll_testing.h"
#include "evpose/client.h"
#include "evpose/recording.h"
#include "server/stores/redis/redis_testing.h"
#include "tests/integration/survival_testing.h"

namespace evpose {
namespace {

// Kills the master of a group, and then brings the group back to three nodes, in a thread. It is one thread for all
// kills, because a Redis process ends with the thread that started it.
class MasterKiller {
 public:
  explicit MasterKiller(server::RedisGroup& group) : group_(group), thread_([this] { Run(); }) {}
  ~MasterKiller() {
    {
      const std::lock_guard lock(mutex_);
      is_stopped_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }

  // To be called when the group has recovered.
  void Kill() {
    const size_t master = group_.Master();
    group_.node(master).Kill();
    {
      const std::lock_guard lock(mutex_);
      killed_ = master;
    }
    changed_.notify_all();
  }
  bool has_recovered() {
    const std::lock_guard lock(mutex_);
    return !killed_.has_value();
  }
  void AwaitRecovery() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return !killed_.has_value(); });
  }

 private:
  void Run() {
    std::unique_lock lock(mutex_);
    while (true) {
      changed_.wait(lock, [this] { return is_stopped_ || killed_.has_value(); });
      if (!killed_.has_value()) return;
      const size_t node = *killed_;
      lock.unlock();
      group_.AwaitFailover(node);
      group_.Restart(node);
      lock.lock();
      killed_.reset();
      changed_.notify_all();
    }
  }

  server::RedisGroup& group_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<size_t> killed_;  // the node that is not back yet
  bool is_stopped_ = false;
  std::thread thread_;  // the last member, because it uses the others
};

class SentinelSurvivalTest : public SurvivalFixture {
 protected:
  // Does the same as MakeClient(), and repeats the calls while they end with UNAVAILABLE: on a busy machine a replica
  // may not acknowledge a write within the time that the server waits.
  RawClient MakePatientClient(RunningServer& server, const server::RedisGroup& group, const std::string& request_id) {
    v1::Model model;
    Repeat(group, [&] {
      return server::UploadModel(server.models(), server::UploadRequests(ReadText("cube/model.obj")), &model);
    });
    v1::CreateSessionRequest request;
    request.set_request_id(request_id);
    *request.mutable_config() =
        client::ToProto(client::SessionConfig{.camera = client::LoadCamera(Path("cube/camera.yaml")).value(),
                                              .objects = {{.object_id = "cube", .model = model.name()}}});
    server::CreatedSession session;
    Repeat(group, [&] {
      grpc::ClientContext context;
      return server.sessions().CreateSession(&context, request, session.response());
    });
    return RawClient(chunks_, session);
  }

 private:
  static void Repeat(const server::RedisGroup& group, const std::function<grpc::Status()>& call) {
    grpc::Status status = call();
    while (status.error_code() == grpc::StatusCode::UNAVAILABLE) {
      group.AwaitReplicas(2);
      status = call();
    }
    EXPECT_TRUE(status.ok()) << status.error_message();
  }
};

TEST_F(SentinelSurvivalTest, KilledMastersLoseNothing) {
  const std::vector<std::string> expected = Undisturbed();
  ASSERT_GT(expected.size(), 100u);
  server::RedisGroup group(
      {.password = "", .down_after = absl::Milliseconds(NumberFrom("EVPOSE_DOWN_AFTER_MS", 5000))});
  group.AwaitSentinels();
  RunningServer server({"--store", group.url(), "--log-level", "warning"});
  MasterKiller killer(group);
  std::mt19937 random(7);
  const int kills_wanted = NumberFrom("EVPOSE_KILLS", 5);
  int kills = 0;
  int runs = 0;
  double pose_pause_s = 0.0;
  double durable_pause_s = 0.0;
  for (; kills < kills_wanted; ++runs) {
    RawClient client = MakePatientClient(server, group, "run " + std::to_string(runs));
    size_t kill_at = 1 + random() % (expected.size() / 2);
    client.OnPose([&](size_t poses) {
      if (kills == kills_wanted || poses < kill_at || !killer.has_recovered()) return;
      killer.Kill();
      ++kills;
      kill_at = poses + 1 + random() % (expected.size() / 2);
    });
    ASSERT_TRUE(client.Stream(server, SIZE_MAX)) << "the loss of the master does not end a stream";
    killer.AwaitRecovery();
    ASSERT_EQ(client.poses().size(), expected.size()) << "run " << runs;
    ASSERT_TRUE(client.poses() == expected) << "run " << runs;
    pose_pause_s = std::max(pose_pause_s, client.pose_pause().longest_s());
    durable_pause_s = std::max(durable_pause_s, client.durable_pause().longest_s());
  }
  std::printf(
      "%d kills of the master in %d streams: %d trajectories identical, longest pause of the poses %.2f s, of "
      "their durability %.2f s\n",
      kills, runs, runs, pose_pause_s, durable_pause_s);
  server.program().Signal(SIGTERM);
  EXPECT_EQ(server.program().Wait(), 0);
}

// A session of the client library at a server whose store is a Redis group.
class StaleReplicaTest : public CliTest {
 protected:
  // Chunks that the source is ahead of the server.
  static constexpr uint64_t kAhead = 50;

  void SetUp() override {
    CliTest::SetUp();
    SimulateCube(4.0);
  }

  struct Outcome {
    absl::Status writer;
    absl::Status watcher;
    std::vector<std::string> poses;    // of the writer
    std::vector<std::string> watched;  // of the watcher
    bool is_promoted = false;          // a stale replica became the master
    int num_rollbacks = 0;             // outages of the writer with this reason
  };

  // Tracks the recording beside a watcher. With a group, the store loses acknowledged commits on the way.
  static Outcome Track(const std::string& address, const std::string& folder, const client::TrackOptions& options,
                       server::RedisGroup* group) {
    const auto client = client::Client::Connect(address).value();
    const auto recording = client::Recording::Open(folder + "/recording.raw").value();
    client::SessionConfig config;
    config.encoding = recording->encoding();
    config.camera = client::LoadCamera(folder + "/camera.yaml").value();
    config.objects = {{.object_id = "cube", .model = client->UploadModelFile(folder + "/model.obj").value().name}};
    const client::Session session = client->CreateSession(config).value();

    Outcome outcome;
    std::thread watcher([&] {
      outcome.watcher = client->WatchPoses(session.name, {}, [&](const std::vector<client::Pose>& poses, uint64_t) {
        for (const client::Pose& pose : poses) outcome.watched.push_back(Text(pose));
      });
    });
    std::atomic<uint64_t> processed_seq = 0, durable_seq = 0;
    client::TrackCallbacks callbacks;
    callbacks.on_progress = [&](const client::TrackProgress& progress) { processed_seq = progress.processed_chunks; };
    callbacks.on_pose = [&](const client::Pose& pose) { outcome.poses.push_back(Text(pose)); };
    callbacks.on_connection = [&](const client::ConnectionChange& change) {
      if (change.is_unreachable && client::ReasonOf(change.cause) == v1::ROLLED_BACK) ++outcome.num_rollbacks;
    };
    callbacks.on_position = [&](const client::TrackPosition& position, bool) {
      durable_seq = position.durable.seq;
      return absl::OkStatus();
    };
    server::RedisContents copy;
    const client::ChunkSource source = [&, seq = uint64_t{0}, copied_seq = uint64_t{0}]() mutable {
      ++seq;
      EXPECT_TRUE(Poll([&] { return seq <= processed_seq + kAhead || options.stop.stop_requested(); })) << seq;
      if (group != nullptr && copied_seq == 0 && durable_seq > 0) {
        copy = group->master().Contents();
        copied_seq = seq;
      }
      // The client knows of a commit that is not in the copy.
      if (copied_seq > 0 && durable_seq > copied_seq && !outcome.is_promoted) {
        outcome.is_promoted = true;
        group->PromoteStale(copy);
      }
      return recording->Next();
    };
    outcome.writer = client->Track(session, source, callbacks, options).status();
    watcher.join();
    return outcome;
  }

  // Runs a server on a group of which a stale replica becomes the master.
  Outcome TrackWithLoss(absl::Duration retain) {
    server::RedisGroup group;
    group.AwaitSentinels();
    RunningServer server({"--store", group.url(), "--log-level", "warning"});
    client::TrackOptions options;
    options.retain.duration = retain;
    Outcome outcome = Track(server.address(), Path("cube"), options, &group);
    server.program().Signal(SIGTERM);
    EXPECT_EQ(server.program().Wait(), 0);
    return outcome;
  }

 private:
  static std::string Text(const client::Pose& pose) {
    std::ostringstream text;
    text << pose.seq << " " << pose.t_us << " " << pose.num_events << std::hexfloat;
    const auto append = [&text](const auto& matrix) {
      for (const double number : matrix.reshaped()) text << " " << number;
    };
    append(pose.camera_from_object.rotation);
    append(pose.camera_from_object.translation_m);
    append(pose.covariance);
    return text.str();
  }
};

TEST_F(StaleReplicaTest, AcknowledgedCommitsThatAreLostCostAResendOrAreReported) {
  Outcome undisturbed;
  {
    RunningServer server({"--store", "memory", "--log-level", "warning"});
    undisturbed = Track(server.address(), Path("cube"), {}, nullptr);
  }
  ASSERT_EQ(undisturbed.writer, absl::OkStatus());
  ASSERT_GT(undisturbed.poses.size(), 100u);
  EXPECT_EQ(undisturbed.watched, undisturbed.poses);

  const Outcome resent = TrackWithLoss(absl::Hours(1));
  EXPECT_EQ(resent.writer, absl::OkStatus());
  EXPECT_EQ(resent.watcher, absl::OkStatus());
  EXPECT_TRUE(resent.is_promoted) << "too few commits were acknowledged";
  EXPECT_GT(resent.num_rollbacks, 0) << "the store has lost nothing";
  EXPECT_TRUE(resent.poses == undisturbed.poses);
  EXPECT_TRUE(resent.watched == undisturbed.poses);

  const Outcome lost = TrackWithLoss(absl::ZeroDuration());
  EXPECT_EQ(lost.writer.code(), absl::StatusCode::kDataLoss) << lost.writer;
  EXPECT_EQ(client::ReasonOf(lost.writer), v1::ROLLED_BACK);
  // A watcher that had received everything before the loss was noticed is not told.
  if (lost.watcher.ok()) {
    EXPECT_TRUE(lost.watched == undisturbed.poses);
  } else {
    EXPECT_EQ(lost.watcher.code(), absl::StatusCode::kDataLoss) << lost.watcher;
    EXPECT_EQ(client::ReasonOf(lost.watcher), v1::ROLLED_BACK);
  }
}

}  // namespace
}  // namespace evpose
