// SPDX-License-Identifier: Apache-2.0

// Chooses the server that a call goes to, and the next one when that server does not respond. Internal, because it
// includes generated headers.
#pragma once

#include <atomic>
#include <cstddef>
#include <deque>
#include <stop_token>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "client/lib/endpoint.h"
#include "client/lib/stream/retry.h"
#include "evpose/clock.h"

namespace evpose::client {

// Returns whether a call failed because its server cannot be reached, shuts down or has lost its store, so that another
// server may respond.
bool IsServerAway(const absl::Status& status);

// Returns whether a server has refused a new session because it has no room for it, so that another server may create
// it. The quota of a tenant is not a reason: the caller can delete a session.
bool IsServerFull(const absl::Status& status);

// The servers that one call is made to, in turn. Used by one thread.
class ServerChoice {
 public:
  // Attempts at each server without a response, after which a call fails.
  static constexpr size_t kMaxRounds = 3;

  // Begins with the server `current`, which is changed to the one that responds when others do not, and waits a moment
  // for its connection if it was lost. `stop` is that of the call. With `skips_full_servers`, a call goes to the next
  // server also if IsServerFull(), and a call to a server that has refused an earlier one has a new connection. The
  // references must outlive the object.
  ServerChoice(std::deque<Endpoint>& endpoints, std::atomic<size_t>& current, Clock& clock, const std::stop_token& stop,
               bool skips_full_servers = false);

  Endpoint& endpoint() const { return endpoints_[index_]; }
  // Informs the object of a response of the server.
  void Responded();
  // Chooses the next server if `status` means that this server is unreachable. Each server is tried once without delay,
  // then again after growing delays. Returns false if the call is not to be repeated: the server has responded, there
  // is no other server, a stop was requested, or each has been tried kMaxRounds times, or, if one was full, once or
  // twice. If a full server has refused the session, NOT_FOUND for the model from a later server is treated like a
  // refusal: the next server is tried, because models may be stored at some servers only.
  bool Next(const absl::Status& status);
  // Chooses the next server, because this one has refused and another one may accept. Waits a moment for its connection
  // if it was lost.
  void Skip();
  // Returns the status of a call that is not repeated, with the servers that were tried: the refusal of a full server
  // if there was one and the last server does not know the model, because the full one may accept the session later.
  // The delay of RetryInfo is the shortest one of the full servers.
  absl::Status Final(const absl::Status& status) const;

 private:
  void Advance() { index_ = (index_ + 1) % endpoints_.size(); }
  bool IsRefusal(const absl::Status& status) const;
  bool NextWithRoom(const absl::Status& refusal);
  // Prepares the connection for the next attempt.
  void Prepare() const;
  // Waits a moment for the connection; in the last round the call waits itself, and its status has the cause.
  bool Connect() const;

  std::deque<Endpoint>& endpoints_;
  std::atomic<size_t>& current_;
  Clock& clock_;
  const std::stop_token stop_;
  size_t index_;
  size_t num_failed_ = 0;  // attempts since the last response
  Backoff backoff_;
  const bool skips_full_servers_;
  absl::Status refusal_;                                // the last one by a full server
  size_t num_refusals_ = 0;                             // by full servers, and afterwards by those without the model
  absl::Duration retry_in_ = absl::InfiniteDuration();  // the shortest delay of RetryInfo of the full servers
};

}  // namespace evpose::client
