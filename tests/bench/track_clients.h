// SPDX-License-Identifier: Apache-2.0

// The clients of the load test: writers, readers, and stalled readers.
#pragma once

#include <grpcpp/grpcpp.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "evpose/v1/session_service.grpc.pb.h"
#include "server/rpc/raw_requests_testing.h"
#include "tests/bench/scene.h"

namespace evpose::bench {

using Clock = std::chrono::steady_clock;

// The poses that a stream received, and their latencies since the sending of the chunk with their time.
struct PosesSeen {
  uint64_t poses = 0;
  uint64_t lost = 0;  // poses whose numbers are missing, and those that the server reported as skipped
  std::vector<float> latencies_ms;
};

// Sends a scene in real time, chunk k at `begin` + k ms as far as credit allows, and reads the responses. Uses two
// threads.
class Streamer {
 public:
  // `session` is the response of CreateSession.
  Streamer(v1::SessionService::Stub& stub, const server::CreatedSession& session, const Scene& scene,
           Clock::time_point begin);
  // Returns when the summary has been received or the stream has ended.
  void Join();

  bool is_ok() const { return status_.ok() && has_summary_; }
  const grpc::Status& status() const { return status_; }
  const PosesSeen& seen() const { return seen_; }
  const v1::SessionHealth& health() const { return health_; }

 private:
  void Send(const server::CreatedSession& session);
  void Read();

  const Scene& scene_;
  const Clock::time_point begin_;
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::TrackRequest, v1::TrackResponse>> stream_;
  std::mutex mutex_;
  std::condition_variable changed_;
  uint64_t send_limit_bytes_ = 0;                 // guarded by mutex_
  bool is_attached_ = false;                      // guarded by mutex_
  bool is_over_ = false;                          // guarded by mutex_
  std::vector<std::atomic<int64_t>> sent_at_us_;  // per chunk, after begin_
  PosesSeen seen_;
  v1::SessionHealth health_;
  bool has_summary_ = false;
  grpc::Status status_;
  std::thread sender_, reader_;
};

// A reader of WatchPoses. A stalled reader starts the call and never reads.
class Watcher : public grpc::ClientReadReactor<v1::WatchPosesResponse> {
 public:
  Watcher(v1::SessionService::Stub& stub, const std::string& session, double max_rate_hz, bool is_stalled);
  void OnReadDone(bool ok) override;
  void OnDone(const grpc::Status& status) override;

  void Cancel() { context_.TryCancel(); }
  void Join();  // healthy readers end with their session, stalled ones when they are cancelled
  uint64_t poses() const { return poses_; }
  uint64_t skipped() const { return skipped_; }
  const grpc::Status& status() const { return status_; }

 private:
  grpc::ClientContext context_;
  v1::WatchPosesRequest request_;
  v1::WatchPosesResponse response_;
  uint64_t poses_ = 0, skipped_ = 0;
  grpc::Status status_;
  std::mutex mutex_;
  std::condition_variable done_;
  bool is_done_ = false;  // guarded by mutex_
};

}  // namespace evpose::bench
