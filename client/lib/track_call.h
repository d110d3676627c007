// SPDX-License-Identifier: Apache-2.0

// One Track stream, from attach to its end. Internal: it includes generated headers.
#pragma once

#include <grpcpp/client_context.h>

#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "client/lib/track.h"
#include "client/lib/uplink.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

struct TrackCallOptions {
  std::string resume_token;        // to attach with
  uint64_t attach_after_pose = 0;  // poses up to TrackPosition::last_pose_seq that come again are dropped
  bool leaves_on_go_away = false;  // the session can be taken up elsewhere or later
};

struct TrackOutcome {
  absl::Status status;    // OK: the summary came, or the server was left
  bool is_final = false;  // it is of this side, or the server breaks the protocol
  bool was_attached = false;
  bool made_progress = false;            // the server processed something
  std::optional<SessionHealth> summary;  // the stream has ended as it should
};

// Used once, by one thread.
class TrackCall {
 public:
  // `position` follows what comes. The arguments must outlive it.
  TrackCall(v1::SessionService::StubInterface& stub, TrackPosition& position, EventFeed& feed,
            const TrackCallbacks& callbacks, const TrackOptions& options, const TrackCallOptions& call_options);

  TrackOutcome Run();
  uint64_t fed_bytes() const { return uplink_.fed_bytes(); }

 private:
  // Writes `attach` and starts the uplink on `attached`; false when the stream or the server is broken.
  bool Attach();
  bool ReadBeforeTimeout(v1::TrackResponse& response);
  bool HandleAttached(const v1::TrackResponse::Attached& attached);
  // False when the server sent what it never may, or a callback failed; outcome_ says what.
  bool Handle(const v1::TrackResponse& response);
  bool HandlePose(const v1::Pose& message);
  bool HandleAck(const v1::TrackResponse::Ack& ack);
  bool HandleNotice(const v1::TrackResponse::Notice& message);
  bool ReportPosition(bool has_new_token);
  bool Fail(const absl::Status& status);
  bool Malformed(const std::string& what);
  void Cancel() { context_.TryCancel(); }
  void Conclude(const grpc::Status& stream_status);

  TrackPosition& position_;
  EventFeed& feed_;
  const TrackCallbacks& callbacks_;
  const TrackOptions& options_;
  const TrackCallOptions call_options_;
  grpc::ClientContext context_;
  std::unique_ptr<Uplink::Stream> stream_;
  Uplink uplink_;
  TrackOutcome outcome_;
  uint64_t next_pose_seq_ = 1;  // on this stream
  uint64_t first_processed_seq_ = 0;
  bool is_left_ = false;
  bool timed_out_ = false;
};

}  // namespace evpose::client
