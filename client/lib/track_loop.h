// SPDX-License-Identifier: Apache-2.0

// A session's streams, one after the other, until its summary. Internal: it includes generated headers.
#pragma once

#include <atomic>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/lib/track.h"
#include "client/lib/track_call.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

struct TrackServer {
  std::string name;
  v1::SessionService::StubInterface* stub = nullptr;
  // The channel's own wait after failures is over: the loop has waited. May be empty.
  std::function<void()> connect_now = {};
};

// Used once, by one thread.
class TrackLoop {
 public:
  // `current` is the server to begin with, and then the one that has the stream. `outlives_server`: sessions do, in a
  // store. The arguments must outlive it.
  TrackLoop(const std::vector<TrackServer>& servers, std::atomic<size_t>& current, bool outlives_server,
            const TrackPosition& position, EventFeed& feed, const TrackCallbacks& callbacks,
            const TrackOptions& options);

  absl::StatusOr<TrackSummary> Run();

 private:
  TrackOutcome RunOnce();
  void Observe(const TrackOutcome& outcome);
  // What the next try does otherwise; false when there is to be none.
  bool Plan(const TrackOutcome& outcome);
  // Waits for the next try; false when there is to be none.
  bool WaitForNextTry(const absl::Status& cause);
  void ReportAttached();
  const TrackServer& server() const { return servers_[current_]; }
  Clock& clock() const { return options_.clock == nullptr ? SystemClock() : *options_.clock; }
  absl::Status WithProgress(const absl::Status& status) const;

  const std::vector<TrackServer>& servers_;
  std::atomic<size_t>& current_;
  const bool outlives_server_;
  TrackPosition position_;
  EventFeed& feed_;
  const TrackCallbacks& callbacks_;
  const TrackOptions& options_;
  Backoff backoff_;
  uint64_t fed_bytes_ = 0;
  absl::Time attached_at_;
  std::optional<absl::Time> away_since_;
  size_t tries_ = 0;            // since it is away
  size_t servers_without_ = 0;  // in a row, that do not have the session
  size_t damaged_tries_ = 0;    // in a row
  bool uses_previous_token_ = false;
  bool attaches_without_count_ = false;
};

}  // namespace evpose::client
