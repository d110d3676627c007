// SPDX-License-Identifier: Apache-2.0

// Re-establishes the stream of a session until the summary arrives. Internal: it includes generated headers.
#pragma once

#include <atomic>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/lib/stream/event_feed.h"
#include "client/lib/stream/retry.h"
#include "client/lib/stream/stream_attempt.h"
#include "evpose/track.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

struct StreamServer {
  using Stub = std::shared_ptr<v1::SessionService::StubInterface>;

  std::string name;
  // Waits a moment for the connection of the channel, without the channel's own delay, because the loop has waited
  // already. Returns the stub, which an attempt keeps until its end. After a refusal it has a new connection.
  std::function<Stub()> connect;
  // Is called when the server has refused a stream because it has no room for the session.
  std::function<void()> note_refusal;
  // Returns the authentication token that a call would now send. May be empty: the token never changes.
  std::function<std::string()> auth_token = {};
};

// Used once, by one thread.
class ReconnectingStream {
 public:
  // `current` is the index of the first server to try, and is updated to that of the server with the stream.
  // `outlives_server`: sessions are in a persistent store. The arguments must outlive the object.
  ReconnectingStream(const std::vector<StreamServer>& servers, std::atomic<size_t>& current, bool outlives_server,
                     const TrackPosition& position, EventFeed& feed, const TrackCallbacks& callbacks,
                     const TrackOptions& options);

  absl::StatusOr<TrackSummary> Run();

 private:
  AttemptOutcome RunOnce();
  // The current token, the previous one, and older ones.
  std::vector<std::string> Tokens() const;
  void Observe(const AttemptOutcome& outcome);
  // Adapts the next attempt to the error; returns false if the error is final.
  bool Plan(const AttemptOutcome& outcome);
  // Waits for the next attempt; returns false if there is none.
  bool WaitForNextTry(const absl::Status& cause);
  void ReportAttached();
  // Calls on_connection, with the state of the outbox in addition.
  void Report(ConnectionChange change) const;
  const StreamServer& server() const { return servers_[index_]; }
  Clock& clock() const { return options_.clock == nullptr ? SystemClock() : *options_.clock; }
  absl::Status WithProgress(const absl::Status& status) const;

  const std::vector<StreamServer>& servers_;
  std::atomic<size_t>& current_;  // other calls change it, too
  size_t index_;                  // the server of this stream
  const bool outlives_server_;
  TrackPosition position_;
  EventFeed& feed_;
  const TrackCallbacks& callbacks_;
  const TrackOptions& options_;
  Backoff backoff_;
  StreamTrace trace_;  // of the last attempt
  uint64_t fed_bytes_ = 0;
  absl::Time attached_at_;
  std::optional<absl::Time> away_since_;
  size_t tries_ = 0;                        // in this outage
  size_t num_servers_without_session_ = 0;  // consecutive
  size_t damaged_tries_ = 0;                // consecutive
  std::string auth_token_;                  // at the start of the last attempt
  // Earlier tokens, the latest first. A store that has lost the last attaches knows one of these.
  std::deque<std::string> older_tokens_;
  size_t token_age_ = 0;  // token of the next attempt: 0 the current one, 1 the previous one, then older_tokens_
  bool attaches_from_first_pose_ = false;
};

}  // namespace evpose::client
