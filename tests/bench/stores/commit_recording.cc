// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/stores/commit_recording.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/bench/bench_session.h"
#include "client/bench/load_recording.h"
#include "client/bench/load_run.h"
#include "core/base/status_macros.h"
#include "evpose/client.h"
#include "server/rpc/server_impl.h"
#include "server/sessions/tracker_factory.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

class RecordingLease : public SessionLease {
 public:
  RecordingLease(std::unique_ptr<SessionLease> lease, std::shared_ptr<CommitRecorder> recorder)
      : lease_(std::move(lease)), recorder_(std::move(recorder)) {}

  void Commit(SessionCommit commit, Done done) override {
    recorder_->Add(commit);
    lease_->Commit(std::move(commit), std::move(done));
  }
  const FencingToken& token() const override { return lease_->token(); }

 private:
  const std::unique_ptr<SessionLease> lease_;
  const std::shared_ptr<CommitRecorder> recorder_;
};

}  // namespace

CommitBytes BytesOf(const SessionRecording& recording) {
  CommitBytes bytes;
  for (const RecordedCommit& recorded : recording.commits) {
    const SessionCommit& commit = recorded.commit;
    if (commit.checkpoint.has_value()) bytes.checkpoints += commit.checkpoint->size();
    if (commit.lifecycle.has_value()) bytes.lifecycles += commit.lifecycle->size();
    bytes.poses += SizeBytes(commit.poses);
  }
  return bytes;
}

uint64_t LastPoseSeq(const SessionRecording& recording) {
  uint64_t last = 0;
  for (const RecordedCommit& recorded : recording.commits) {
    if (!recorded.commit.poses.empty()) last = recorded.commit.poses.back().last_pose_seq;
  }
  return last;
}

void CommitRecorder::Begin(const SessionRecord& record, const std::string& lifecycle) {
  const std::lock_guard lock(mutex_);
  begin_ = std::chrono::steady_clock::now();
  recording_ = {.record = record, .lifecycle = lifecycle, .commits = {}};
}

void CommitRecorder::Add(const SessionCommit& commit) {
  const std::lock_guard lock(mutex_);
  const auto at = std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now() - begin_);
  recording_.commits.push_back({at, commit});
}

SessionRecording CommitRecorder::Get() const {
  const std::lock_guard lock(mutex_);
  return recording_;
}

RecordingStore::RecordingStore(std::shared_ptr<CommitRecorder> recorder)
    : FaultInjectingStore(MakeMemoryStore(), std::make_shared<InjectedFault>()), recorder_(std::move(recorder)) {}

absl::StatusOr<std::unique_ptr<SessionLease>> RecordingStore::CreateSession(const SessionRecord& record,
                                                                            const std::string& lifecycle) {
  recorder_->Begin(record, lifecycle);
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<SessionLease> lease, FaultInjectingStore::CreateSession(record, lifecycle));
  return std::make_unique<RecordingLease>(std::move(lease), recorder_);
}

absl::StatusOr<SessionRecording> RecordSession(double rate_hz, double seconds) {
  constexpr int64_t kChunkUs = 1000;
  EVPOSE_ASSIGN_OR_RETURN(const auto input, client::LoadRecording::Make(rate_hz, kChunkUs));
  const auto recorder = std::make_shared<CommitRecorder>();
  ServerOptions options;
  options.listen_address = "127.0.0.1:0";
  EVPOSE_ASSIGN_OR_RETURN(const auto server,
                          StartServer(options, MakeTrackerFactory(), std::make_unique<RecordingStore>(recorder)));
  client::LoadOptions load;
  load.addresses = absl::StrCat("127.0.0.1:", server->port());
  EVPOSE_ASSIGN_OR_RETURN(const auto client, client::Client::Connect(load.addresses));
  EVPOSE_ASSIGN_OR_RETURN(load.config, client::UploadSession(*client, input.scene(), Encoding::kEvt3));
  load.minutes = seconds / 60.0;
  SessionRecording recording;
  load.on_end = [&] { recording = recorder->Get(); };  // before the end of the session
  EVPOSE_ASSIGN_OR_RETURN(const client::LoadResult result,
                          client::RunLoad(load, input, [](double, const client::LoadCounts&) { return true; }));
  if (!result.counts.IsComplete() || recording.commits.empty()) {
    return absl::InternalError(absl::StrCat("the session has lost ", result.counts.lost_poses, " poses and made ",
                                            recording.commits.size(), " commits"));
  }
  return recording;
}

}  // namespace evpose::server
