// SPDX-License-Identifier: Apache-2.0

// The client library with a server whose store loses its last commits: a replica without them becomes the master.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/lib/client_access.h"
#include "client/lib/messages/conversion.h"
#include "core/base/poll_testing.h"
#include "core/base/status_macros.h"
#include "evpose/client.h"
#include "server/rpc/server_impl.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose {
namespace {

// The contents of a master before each of its last commits. A replica has one of these when it takes over.
class StaleReplicas {
 public:
  static constexpr size_t kMaxReplicas = 10;

  explicit StaleReplicas(std::shared_ptr<server::MemorySessions> master) : master_(std::move(master)) {}
  void OnCommit() {
    const std::lock_guard lock(mutex_);
    replicas_.push_back(master_->Copy());
    if (replicas_.size() > kMaxReplicas) replicas_.pop_front();
  }
  // Makes the replica without the last `num_commits` commits the master.
  void Promote(size_t num_commits) {
    const std::lock_guard lock(mutex_);
    ASSERT_LE(num_commits, replicas_.size());
    master_->Replace(replicas_[replicas_.size() - num_commits]);
    replicas_.clear();
  }
  size_t NumCommits() {
    const std::lock_guard lock(mutex_);
    return replicas_.size();
  }
  void Clear() {
    const std::lock_guard lock(mutex_);
    replicas_.clear();
  }

 private:
  const std::shared_ptr<server::MemorySessions> master_;
  std::mutex mutex_;
  std::deque<server::MemorySessions::Contents> replicas_;
};

class ReplicatedLease : public server::SessionLease {
 public:
  ReplicatedLease(std::unique_ptr<SessionLease> lease, std::shared_ptr<StaleReplicas> replicas)
      : lease_(std::move(lease)), replicas_(std::move(replicas)) {}
  void Commit(server::SessionCommit commit, Done done) override {
    replicas_->OnCommit();
    lease_->Commit(std::move(commit), std::move(done));
  }
  const server::FencingToken& token() const override { return lease_->token(); }

 private:
  const std::unique_ptr<SessionLease> lease_;
  const std::shared_ptr<StaleReplicas> replicas_;
};

class ReplicatedStore : public server::FaultInjectingStore {
 public:
  ReplicatedStore(std::shared_ptr<server::Store> master, std::shared_ptr<StaleReplicas> replicas)
      : FaultInjectingStore(std::move(master), std::make_shared<server::InjectedFault>()),
        replicas_(std::move(replicas)) {}
  absl::StatusOr<std::unique_ptr<server::SessionLease>> CreateSession(const server::SessionRecord& record,
                                                                      const std::string& lifecycle) override {
    EVPOSE_ASSIGN_OR_RETURN(auto lease, FaultInjectingStore::CreateSession(record, lifecycle));
    return std::make_unique<ReplicatedLease>(std::move(lease), replicas_);
  }
  absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) override {
    EVPOSE_ASSIGN_OR_RETURN(AcquiredSession acquired, FaultInjectingStore::AcquireSession(name));
    acquired.lease = std::make_unique<ReplicatedLease>(std::move(acquired.lease), replicas_);
    return acquired;
  }

 private:
  const std::shared_ptr<StaleReplicas> replicas_;
};

// A session of kChunks chunks with kChunkMs poses each. At most four of them wait for a commit.
class RollbackClientTest : public ::testing::Test {
 protected:
  static constexpr int kChunks = 40;
  static constexpr int kBefore = 30;
  static constexpr uint64_t kDurable = 25;
  static constexpr int64_t kChunkMs = 1100;

  RollbackClientTest() {
    server::ServerOptions options;
    options.listen_address = "";
    options.worker_threads = 2;
    server_ = server::StartServer(options, server::FakeTrackers(),
                                  std::make_unique<ReplicatedStore>(server::MakeMemoryStore(master_), replicas_))
                  .value();
    client_ = client::ClientAccess::OverChannel(server_->InProcessChannel(), "test server");
    const std::vector<uint8_t> cube(server::kCubeObj, server::kCubeObj + std::strlen(server::kCubeObj));
    model_ = client_->UploadModel(cube, {}).value().name;
  }

  client::Session Create() {
    client::SessionConfig config;
    config.encoding = client::EventEncoding::kFlat64;
    config.camera = {.width_px = 320, .height_px = 240, .fx_px = 300, .fy_px = 300, .cx_px = 160, .cy_px = 120};
    config.objects = {{.object_id = "cube", .model = model_, .initial_camera_from_object = client::Transform()}};
    return client_->CreateSession(config).value();
  }

  // Tracks a new session. When kDurable of the first kBefore chunks are durable, the last `num_commits` commits are
  // lost. Returns all poses as text.
  absl::StatusOr<std::vector<std::string>> Track(const client::TrackOptions& options, size_t num_commits = 0) {
    const client::Session session = Create();
    replicas_->Clear();
    std::vector<std::string> poses;
    std::atomic<uint64_t> durable_seq = 0;
    client::TrackCallbacks callbacks;
    callbacks.on_pose = [&poses](const client::Pose& pose) {
      const auto& t = pose.camera_from_object.translation_m;
      poses.push_back(absl::StrCat(pose.seq, " ", pose.t_us, " ", pose.num_events, " ", t.x(), " ", t.y(), " ", t.z()));
    };
    callbacks.on_connection = [this](const client::ConnectionChange& change) {
      num_outages_ += change.is_unreachable ? 1 : 0;
    };
    callbacks.on_position = [&durable_seq](const client::TrackPosition& position, bool) {
      durable_seq = position.durable.seq;
      return absl::OkStatus();
    };
    const client::ChunkSource source = [&, chunk = int64_t{0}]() mutable -> absl::StatusOr<client::EventChunk> {
      if (chunk == kChunks) return client::EventChunk{};
      if (chunk == kBefore && num_commits > 0) {
        if (!Poll([&] { return durable_seq >= kDurable; })) return absl::DeadlineExceededError("nothing is durable");
        replicas_->Promote(std::min(num_commits, replicas_->NumCommits()));
      }
      const std::string bytes =
          server::Flat64(server::SomeEvents(chunk * kChunkMs + 1, (chunk + 1) * kChunkMs + 1, /*per_ms=*/1));
      ++chunk;
      return client::EventChunk{.bytes = std::vector<uint8_t>(bytes.begin(), bytes.end()),
                                .t_last_us = (chunk + 1) * kChunkMs * 1000};
    };
    EVPOSE_RETURN_IF_ERROR(client_->Track(session, source, callbacks, options).status());
    EVPOSE_RETURN_IF_ERROR(client_->DeleteSession(session.name));  // the replicas are smaller without it
    return poses;
  }

  const std::shared_ptr<server::MemorySessions> master_ = std::make_shared<server::MemorySessions>(UINT64_MAX);
  const std::shared_ptr<StaleReplicas> replicas_ = std::make_shared<StaleReplicas>(master_);
  std::unique_ptr<server::Server> server_;
  std::unique_ptr<client::Client> client_;
  std::string model_;
  int num_outages_ = 0;
};

TEST_F(RollbackClientTest, LostCommitsCostOnlyAResend) {
  const auto undisturbed = Track({});
  ASSERT_TRUE(undisturbed.ok()) << undisturbed.status();
  EXPECT_EQ(undisturbed->size(), size_t{kChunks * kChunkMs});
  EXPECT_EQ(num_outages_, 0);
  for (const size_t num_commits : {1, 2, 5, 8}) {
    num_outages_ = 0;
    const auto poses = Track({}, num_commits);
    ASSERT_TRUE(poses.ok()) << num_commits << ": " << poses.status();
    EXPECT_EQ(*poses, *undisturbed) << num_commits;
    EXPECT_GT(num_outages_, 0) << num_commits;
  }
}

TEST_F(RollbackClientTest, CommitsBeyondTheMarginEndTheSession) {
  client::TrackOptions options;
  options.retain.duration = absl::ZeroDuration();
  const auto poses = Track(options, StaleReplicas::kMaxReplicas);
  EXPECT_EQ(poses.status().code(), absl::StatusCode::kDataLoss) << poses.status();
  EXPECT_EQ(client::ReasonOf(poses.status()), v1::ROLLED_BACK);
  EXPECT_THAT(std::string(poses.status().message()), ::testing::HasSubstr("the session has ended"));
}

}  // namespace
}  // namespace evpose
