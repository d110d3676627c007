// SPDX-License-Identifier: Apache-2.0

// Data that a session exchanges with the stream attached to it, and the notices that it sends beside the poses.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "core/events/event.h"
#include "core/tracking/tracker.h"
#include "server/sessions/types/overload.h"

namespace evpose::server {

struct EventChunk {
  uint64_t seq = 0;  // from 1; resets of poses are numbered along with the chunks
  bool discontinuity = false;
  std::optional<uint32_t> crc32c;
  std::string payload;
};

struct DecodeFault {
  uint64_t seq = 0;
  uint64_t count = 0;
  std::string detail;
};
struct StateChange {
  uint32_t object_index = 0;
  int64_t t_us = 0;
  TrackState state = TrackState::kInitializing;
};
// The stored state of the tracker was unreadable when the session was resumed: a new tracker searches for every object.
struct TrackingRestarted {
  uint64_t after_seq = 0;  // the last chunk that the previous tracker processed
  std::string detail;      // the reason, for people
  // The last pose that is stored. Later ones, which the writer may have received, are not reproduced.
  uint64_t after_pose_seq = 0;
};
// The session has begun or ceased to be processed more slowly than its camera sends (server/scheduling/pace_monitor.h).
struct LagChange {
  bool is_behind = false;
  int64_t lag_us = 0;  // waiting time of the oldest unprocessed chunk
};
// The edges on the trigger inputs in one chunk: at most as many as a notice can hold, and the number of further ones.
struct ChunkTriggers {
  uint64_t seq = 0;
  std::vector<Trigger> triggers;
  uint64_t num_skipped = 0;
};
struct SessionNotice {
  uint64_t after_pose_seq = 0;  // its place among the poses
  std::variant<DecodeFault, StateChange, EventsDropped, TrackingRestarted, LagChange, ChunkTriggers> what;
};

struct SessionAck {
  uint64_t processed_seq = 0;
  uint64_t durable_seq = 0;
  uint64_t send_limit_bytes = 0;
  uint64_t last_pose_seq = 0;  // number of the last pose of the chunks up to processed_seq

  friend bool operator==(const SessionAck&, const SessionAck&) = default;
};

// Result of Session::Attach.
struct Attachment {
  uint64_t stream = 0;  // identifies this stream in the other calls of the session
  uint64_t next_seq = 0;
  std::string resume_token;
  uint64_t send_limit_bytes = 0;
  uint64_t first_pose_seq = 0;
};

// State of the session from which a stream decides its next action.
struct StreamView {
  absl::Status status;        // not OK: the stream must end with this status (fenced, deleted)
  bool has_room = false;      // the session accepts another message
  bool is_idle = false;       // everything pushed has been processed, and all its poses may be sent
  bool is_persisted = false;  // everything that was processed has been persisted, and no item is being processed
  bool is_attached = false;   // the attachment has been persisted: the response `attached` may be sent
  bool has_ended = false;     // `end` has been processed, and all its results have been persisted
  SessionAck ack;
  uint64_t last_pose_seq = 0;  // highest number of a pose that may be sent
};

}  // namespace evpose::server
