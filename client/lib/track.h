// SPDX-License-Identifier: Apache-2.0

// The data plane: events up, poses down, over streams that may break and are taken up again.
#pragma once

#include <cstdint>
#include <functional>
#include <stop_token>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "client/lib/clock.h"
#include "client/lib/event_feed.h"
#include "client/lib/retry.h"
#include "client/lib/types.h"

namespace evpose::client {

// How far a session is: what a client must know to go on with it, in this process or in another one.
struct TrackPosition {
  std::string session;
  // A secret, and the one before it, which is good until something was sent on the stream that gave the new one.
  std::string resume_token;
  std::string previous_token;
  uint64_t last_pose_seq = 0;  // the last pose that was delivered
  uint64_t lost_poses = 0;     // of those before it that were not: the server no longer had them
  FeedPoint durable;           // what precedes it is never asked for again
};

struct TrackProgress {
  uint64_t sent_bytes = 0;
  uint64_t processed_chunks = 0;
  uint64_t poses = 0;
};

// The stream is gone, or back.
struct ConnectionChange {
  bool is_away = false;
  std::string server;          // that is to be tried next, or that took the stream
  absl::Status cause;          // why it is away
  absl::Duration away_for;     // so far
  absl::Duration next_try_in;  // while it is away
  uint64_t kept_bytes = 0;     // of events that wait for the server, or that it may ask for again
  bool source_waits = false;   // there is no room for more of them
};

// Called in the thread that called Track(), in the order in which the server sent. A callback that takes its time
// slows the stream down and loses nothing.
struct TrackCallbacks {
  std::function<void(const Pose&)> on_pose;  // each once, in order
  std::function<void(const Notice&)> on_notice;
  std::function<void(const TrackProgress&)> on_progress;  // whenever the server has processed more
  std::function<void(const ConnectionChange&)> on_connection;
  // After each ack; and with a new token before anything is sent that makes the one before it void: who keeps it
  // elsewhere must have done so on return. What it returns ends the stream when it is not OK.
  std::function<absl::Status(const TrackPosition&, bool has_new_token)> on_position;
};

struct TrackOptions {
  double rate = 0.0;         // sensor seconds per second; 0: as fast as the server gives credit
  Clock* clock = nullptr;    // what paces, and what tries are timed by; nullptr: the machine's
  bool has_checksum = true;  // CRC-32C over each chunk: costs a fraction of a percent and finds a bad link
  absl::Duration attach_timeout = absl::Seconds(10);  // a server that took the call answers at once or never
  RetryOptions retry;
  // Requested by the caller: cancels the stream. Requested by Track() when the stream has ended, so that the source
  // gives up.
  std::stop_source stop;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct TrackSummary {
  SessionHealth health;
  uint64_t sent_bytes = 0;  // of the session, on all streams, each once
  uint64_t sent_chunks = 0;
  uint64_t poses = 0;       // delivered, on all streams
  uint64_t lost_poses = 0;  // made by the server, but no longer stored when the stream was taken up again
};

}  // namespace evpose::client
