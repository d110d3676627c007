// SPDX-License-Identifier: Apache-2.0

// A reader of the poses of a session in a load test. Internal: it includes generated headers.
#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>

#include "absl/base/thread_annotations.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

// Watches one session after the other, and calls again when a call breaks. Thread-safe.
class LoadWatcher {
 public:
  using Time = std::chrono::steady_clock::time_point;

  explicit LoadWatcher(double max_rate_hz);
  // The call under way must have ended: IsIdle().
  ~LoadWatcher();

  // Watches `session`, through `stub`, unless it already does. A session that has ended is not watched again.
  void Watch(v1::SessionService::Stub& stub, const std::string& session, Time now);
  void Cancel();
  bool IsIdle() const;
  uint64_t poses() const;
  uint64_t skipped() const;

 private:
  class Call;

  void OnResponse(const v1::WatchPosesResponse& response);
  void OnDone(const grpc::Status& status);

  const double max_rate_hz_;
  mutable std::mutex mutex_;
  std::string session_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<Call> call_ ABSL_GUARDED_BY(mutex_);
  bool is_calling_ ABSL_GUARDED_BY(mutex_) = false;
  bool has_ended_ ABSL_GUARDED_BY(mutex_) = false;  // the session
  Time again_at_ ABSL_GUARDED_BY(mutex_){};
  uint64_t last_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t poses_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t skipped_ ABSL_GUARDED_BY(mutex_) = 0;
};

}  // namespace evpose::client
