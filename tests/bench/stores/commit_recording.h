// SPDX-License-Identifier: Apache-2.0

// Records the commits of a session between a server and its store.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/sessions/store_testing.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct RecordedCommit {
  std::chrono::microseconds at{0};  // after the creation of the session
  SessionCommit commit;
};

struct SessionRecording {
  SessionRecord record;
  std::string lifecycle;
  std::vector<RecordedCommit> commits;  // in the order of their times
};

// Bytes of the parts of all commits.
struct CommitBytes {
  uint64_t checkpoints = 0;
  uint64_t poses = 0;
  uint64_t lifecycles = 0;
};
CommitBytes BytesOf(const SessionRecording& recording);
// The number of the last pose in the recording; 0 without poses.
uint64_t LastPoseSeq(const SessionRecording& recording);

// Collects the commits of one session. Thread-safe.
class CommitRecorder {
 public:
  void Begin(const SessionRecord& record, const std::string& lifecycle);
  void Add(const SessionCommit& commit);
  // The commits up to now.
  SessionRecording Get() const;

 private:
  mutable std::mutex mutex_;
  std::chrono::steady_clock::time_point begin_ ABSL_GUARDED_BY(mutex_);
  SessionRecording recording_ ABSL_GUARDED_BY(mutex_);
};

// Records the commits of the session that is created last, before they are written to a store in memory. It behaves as
// a store that outlives the process, so that sessions write checkpoints.
class RecordingStore : public FaultInjectingStore {
 public:
  explicit RecordingStore(std::shared_ptr<CommitRecorder> recorder);

  absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                              const std::string& lifecycle) override;

 private:
  const std::shared_ptr<CommitRecorder> recorder_;
};

// Runs a server with one session of `rate_hz` events per second at the pace of its sensor and returns its commits of
// the first `seconds`. Errors: those of the server and of the client; INTERNAL if poses were lost or nothing was
// committed.
absl::StatusOr<SessionRecording> RecordSession(double rate_hz, double seconds);

}  // namespace evpose::server
