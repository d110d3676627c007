// SPDX-License-Identifier: Apache-2.0

// A virtual user of a load test: one session at a time. Internal: it includes generated headers.
#pragma once

#include <grpcpp/grpcpp.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "client/bench/load_counts.h"
#include "client/bench/load_recording.h"
#include "client/bench/load_watcher.h"
#include "client/bench/user_state.h"
#include "client/lib/stream/retry.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

// What all virtual users share. The references must outlive the users.
struct LoadTarget {
  const LoadRecording& recording;
  v1::SessionConfig config;
  // stubs[server][connection]
  std::vector<std::vector<std::unique_ptr<v1::SessionService::Stub>>> stubs;
  double watch_hz = 30.0;
  // Creations that may be under way at a time, so that creations do not time out behind one another.
  std::atomic<int> free_creations = 8;
};

// Creates a session, sends it the recording at the pace of the sensor, and receives its poses. After an error of the
// network or of a server it attaches again, at the next server. The payloads are those of the shared recording, so that
// a user keeps no events. It has no thread: its owner calls Act() once per chunk, and gRPC calls the rest.
// Thread-safe.
class VirtualUser {
 public:
  using Time = std::chrono::steady_clock::time_point;

  VirtualUser(LoadTarget& target, size_t index, size_t num_watchers);
  // No call may be under way: IsIdle().
  ~VirtualUser();

  // Does what is due at `now`, the nominal time of this call: multiples of the chunk's duration apart.
  void Act(Time now);
  // Discards the latencies and pauses measured before this call.
  void BeginMeasuring();
  // Ends the session; the next one follows.
  void Replace();
  // Ends the session; no other follows.
  void Finish();
  // Ends all calls that are under way, without waiting for summaries.
  void Cancel();
  // Finish() was called, and no call is under way.
  bool IsIdle() const;
  // A first creation has succeeded or was refused.
  bool HasResponse() const;
  LoadCounts counts() const;

 private:
  class Stream;
  struct Call;
  // What follows the present session. Every goal except kGoOn ends it: no further events are sent.
  enum class Goal {
    kGoOn,
    kReplace,  // the next session
    kFinish,   // nothing, after the summary of the session
    kCancel,   // nothing; no call is waited for
  };
  // A session with its position. The numbers of chunks and poses begin with 1.
  struct Position {
    std::string name;
    std::vector<std::string> tokens;  // the newest first
    size_t token = 0;                 // the one for the next attach
    uint64_t next_seq = 1;
    uint64_t most_seq = 0;  // the last chunk that was sent, on any stream
    uint64_t last_pose_seq = 0;
    bool attaches_from_first_pose = false;
    bool has_summary = false;
    bool was_attached = false;
    std::optional<Time> began_at;  // the sensor's time zero
    std::optional<Time> away_since;
    size_t servers_without = 0;  // servers that do not have the session, one after the other
    // Times of the last pose. Its window ends half-way to the next pose.
    int64_t last_t_us = -1;
    Time last_arrival{};
    SessionPause pause;  // since the begin of the measurement
  };

  void ChangeState(UserInput input) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { state_ = NextState(state_, input); }
  // No session follows.
  bool MustEnd() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    return goal_ == Goal::kFinish || goal_ == Goal::kCancel;
  }
  v1::SessionService::Stub& stub() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Create(Time now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void OnCreated(const grpc::Status& grpc_status);
  void Attach(Time now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Send() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void SendChunk() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void OnWritten(bool ok);
  void OnResponse(const v1::TrackResponse& response);
  void HandleAttached(const v1::TrackResponse::Attached& attached) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void HandlePose(const v1::Pose& pose) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void OnStreamEnd(const grpc::Status& grpc_status);
  // Chooses the server and the time of the next attach. Returns false after a final error.
  bool PlanRetry(const absl::Status& status, Time now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RecordPause() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Delete() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void OnDeleted();

  LoadTarget& target_;
  const size_t index_;
  std::vector<std::unique_ptr<LoadWatcher>> watchers_;
  mutable std::mutex mutex_;
  UserState state_ ABSL_GUARDED_BY(mutex_) = UserState::kWaiting;  // changed by ChangeState() only
  Goal goal_ ABSL_GUARDED_BY(mutex_) = Goal::kGoOn;
  bool has_response_ ABSL_GUARDED_BY(mutex_) = false;
  Time now_ ABSL_GUARDED_BY(mutex_){};     // of the last Act()
  Time act_at_ ABSL_GUARDED_BY(mutex_){};  // the next creation or attach; kAttaching: the end of the wait
  size_t server_ ABSL_GUARDED_BY(mutex_);  // index of LoadTarget::stubs
  Backoff backoff_ ABSL_GUARDED_BY(mutex_);
  std::string request_id_ ABSL_GUARDED_BY(mutex_);  // of the creation that is repeated; empty: none
  uint64_t num_requests_ ABSL_GUARDED_BY(mutex_) = 0;
  std::unique_ptr<Call> call_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<Stream> stream_ ABSL_GUARDED_BY(mutex_);
  Position session_ ABSL_GUARDED_BY(mutex_);
  // State of the stream.
  bool is_writing_ ABSL_GUARDED_BY(mutex_) = false;
  bool is_shutting_down_ ABSL_GUARDED_BY(mutex_) = false;  // the server, by its GoAway
  bool is_complete_ ABSL_GUARDED_BY(mutex_) = false;       // nothing more is written
  uint64_t sent_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t limit_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  v1::TrackRequest request_ ABSL_GUARDED_BY(mutex_);
  LoadCounts counts_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client
