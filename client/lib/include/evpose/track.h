// SPDX-License-Identifier: Apache-2.0

// The data plane: sends events and receives poses, over streams that may break and are re-established.
#pragma once

#include <cstdint>
#include <functional>
#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "evpose/clock.h"
#include "evpose/types.h"

namespace evpose::client {

// Encoded events, in whole words of the session's encoding.
struct EventChunk {
  std::vector<uint8_t> bytes;
  // Latest sensor time up to the end of the chunk, for the rate, and because no pose can be later; -1: unknown.
  int64_t t_last_us = -1;
  std::vector<PoseReset> resets;  // take effect before the events of the chunk
  bool follows_loss = false;      // bytes were lost before it: the server waits for a full time stamp
};

// Returns the next chunk; one without bytes and resets at the end of the events. Called in a thread of its own, and may
// block; a source that waits for live data must return when TrackOptions::stop is requested.
using ChunkSource = std::function<absl::StatusOr<EventChunk>()>;

// A position between two chunks of a session. Resets are numbered together with chunks. Two positions are equal if the
// same bytes were sent up to there.
struct FeedPoint {
  uint64_t seq = 0;     // number of the chunk before it; 0: the start
  uint64_t bytes = 0;   // payload up to it
  uint32_t digest = 0;  // CRC-32C over the previous digest and the chunk's own CRC-32C

  friend bool operator==(const FeedPoint&, const FeedPoint&) = default;
};

// The position of a session, from which this process or another one can continue it.
struct TrackPosition {
  std::string session;
  // Secrets: the current token and the previous one, which is valid until a message was sent on the stream that
  // returned the current one.
  std::string resume_token;
  std::string previous_token;
  uint64_t last_pose_seq = 0;    // the last delivered pose
  uint64_t lost_poses = 0;       // earlier poses that were not delivered, because the server no longer stored them
  FeedPoint durable;             // data before it is requested again only if the store has lost its last writes
  uint64_t max_piece_bytes = 0;  // size at which chunks of the source were divided; 0: no chunk was sent yet
};

struct TrackProgress {
  uint64_t sent_bytes = 0;        // of the session, on all streams, without repetitions
  uint64_t processed_chunks = 0;  // by the server; with resets
  uint64_t poses = 0;             // delivered, on all streams
};

// Returns the trace ID of a session: 32 hexadecimal digits, by which the log and the exemplars of the metrics of every
// server name it. It is a digest of the name, and does not reveal it.
std::string TraceId(const std::string& session);

// The IDs by which the logs of client and servers name one stream of a session (W3C Trace Context). They are sent with
// the stream as `traceparent`.
struct StreamTrace {
  std::string trace_id;  // TraceId() of the session
  std::string span_id;   // 16 hexadecimal digits, different for each stream

  friend bool operator==(const StreamTrace&, const StreamTrace&) = default;
};

// The stream has broken, or it is re-established.
struct ConnectionChange {
  bool is_unreachable = false;  // false: the stream is re-established
  std::string server;           // the next server to be tried, or the one that accepted the stream
  absl::Status cause;           // cause of the outage
  absl::Duration outage;        // duration of the outage so far
  absl::Duration next_try_in;   // time until the next attempt, during an outage
  uint64_t kept_bytes = 0;      // events that wait for the server, or that it may request again
  bool source_waits = false;    // the storage for events is full
  StreamTrace trace;            // of the stream that has broken, or of the new one
};

// Called in the thread that called Track(), in the order in which the server sent the messages. A slow callback delays
// the stream and loses no data.
struct TrackCallbacks {
  // Once for each pose, in order. After TrackingRestarted, a number can be that of a pose which was not stored.
  std::function<void(const Pose&)> on_pose;
  std::function<void(const Notice&)> on_notice;
  std::function<void(const TrackProgress&)> on_progress;  // after each increase of the processed data
  std::function<void(const ConnectionChange&)> on_connection;
  // Called after each ack, and with a new token before a message that invalidates the previous one: a caller that
  // stores the token elsewhere must have done so on return. A status other than OK ends the stream.
  std::function<absl::Status(const TrackPosition&, bool has_new_token)> on_position;
};

// Conditions under which a broken stream is tried again.
struct RetryOptions {
  // The longest outage that is tolerated, also by a server that grants no credit. The default covers the restart of a
  // server or of its machine. Zero: a broken stream is not tried again, and credit is waited for without a limit;
  // infinite: unlimited.
  absl::Duration max_outage = absl::Minutes(2);
  absl::Duration first_delay = absl::Milliseconds(100);  // doubled after each failed attempt
  absl::Duration max_delay = absl::Seconds(5);           // so that a server that has returned is used soon
  std::function<double()> random;                        // in [0, 1), for the jitter; empty: the machine's generator

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// A server that takes over after its store has lost the last writes, because a replica without them was made the
// master, requests chunks again that were reported as durable. They are kept for this purpose, in memory or in the
// spool. When an earlier one is requested, Track() fails with DATA_LOSS and the reason ROLLED_BACK.
struct RetainOptions {
  absl::Duration duration = absl::Seconds(5);  // from the report; zero: none is kept
  // Payload, and 128 bytes for each chunk; the earliest chunks are dropped beyond it.
  uint64_t max_bytes = 64ull << 20;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct TrackOptions {
  double rate = 0.0;         // sensor seconds per second; 0: limited by the server's credit only
  Clock* clock = nullptr;    // for the rate and for the retries; nullptr: the machine's clock
  bool has_checksum = true;  // CRC-32C of each chunk: costs a fraction of a percent and detects a faulty link
  absl::Duration attach_timeout = absl::Seconds(10);  // a server that accepts the call responds at once
  RetryOptions retry;
  RetainOptions retain;
  // The objects of the session: a pose of another one is a violation of the protocol. Empty: not checked.
  std::vector<std::string> object_ids;
  // A request by the caller cancels the stream. Track() requests it at the end of the stream, so that the source stops.
  std::stop_source stop;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct TrackSummary {
  SessionHealth health;
  uint64_t sent_bytes = 0;   // of the session, on all streams, without repetitions
  uint64_t sent_chunks = 0;  // with resets
  uint64_t poses = 0;        // delivered, on all streams
  uint64_t lost_poses = 0;   // computed by the server, but no longer stored when the stream was re-established
  StreamTrace trace;         // of the last stream
};

}  // namespace evpose::client
