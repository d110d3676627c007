// SPDX-License-Identifier: Apache-2.0

// One Track stream, from attach to its end. Internal: it includes generated headers.
#pragma once

#include <grpcpp/client_context.h>

#include <map>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "client/lib/stream/event_feed.h"
#include "client/lib/stream/uplink.h"
#include "evpose/track.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

struct AttemptOptions {
  std::string resume_token;        // token of the attach message
  uint64_t attach_after_pose = 0;  // repeated poses up to TrackPosition::last_pose_seq are dropped
  bool leaves_on_go_away = false;  // the session can be continued at another server or later
  StreamTrace trace;
};

struct AttemptOutcome {
  absl::Status status;    // OK: the summary was received, or the stream was ended because of go_away
  bool is_final = false;  // the error is on this side, or the server violates the protocol
  bool was_attached = false;
  bool made_progress = false;            // the server processed data
  bool stated_first_seq = false;         // the server was told which chunks can still be sent
  std::optional<SessionHealth> summary;  // the stream ended regularly
};

// Used once, by one thread.
class StreamAttempt {
 public:
  // Updates `position` with the received messages. The arguments must outlive it.
  StreamAttempt(v1::SessionService::StubInterface& stub, TrackPosition& position, EventFeed& feed,
                const TrackCallbacks& callbacks, const TrackOptions& options, const AttemptOptions& attempt_options);

  AttemptOutcome Run();
  uint64_t fed_bytes() const { return uplink_.fed_bytes(); }

 private:
  // Writes `attach` and starts the uplink after `attached`; returns false if the stream is broken or the server
  // violates the protocol.
  bool Attach();
  bool ReadBeforeTimeout(v1::TrackResponse& response);
  bool HandleAttached(const v1::TrackResponse::Attached& attached);
  // Returns false, with the cause in outcome_, if the server violates the protocol or a callback fails.
  bool Handle(const v1::TrackResponse& response);
  bool HandlePose(const v1::Pose& message);
  // Returns why `pose` violates the protocol; empty if it does not.
  std::string ProtocolViolation(const Pose& pose);
  bool HandleAck(const v1::TrackResponse::Ack& ack);
  bool HandleNotice(const v1::TrackResponse::Notice& message);
  bool ReportPosition(bool has_new_token);
  bool Fail(const absl::Status& status);
  bool Malformed(const std::string& what);
  void Cancel() { context_.TryCancel(); }
  // Adds the trace to the context.
  std::unique_ptr<Uplink::Stream> Open(v1::SessionService::StubInterface& stub);
  void Conclude(const grpc::Status& stream_status);

  TrackPosition& position_;
  EventFeed& feed_;
  const TrackCallbacks& callbacks_;
  const TrackOptions& options_;
  const AttemptOptions attempt_options_;
  grpc::ClientContext context_;
  std::unique_ptr<Uplink::Stream> stream_;
  Uplink uplink_;
  AttemptOutcome outcome_;
  uint64_t next_pose_seq_ = 1;                // on this stream
  std::map<std::string, int64_t> last_t_us_;  // time of the latest pose of each object on this stream
  uint64_t first_processed_seq_ = 0;
  bool is_left_ = false;
  bool timed_out_ = false;
};

}  // namespace evpose::client
