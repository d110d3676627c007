// One Track stream, from attach to summary. Internal: it includes generated headers.
#pragma once

#include <grpcpp/client_context.h>

#include <atomic>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "client/lib/track.h"
#include "client/lib/uplink.h"
#include "evpose/v1/sessions.grpc.pb.h"

namespace evpose::client {

// Used once, by one thread.
class TrackCall {
 public:
  TrackCall(v1::SessionService::StubInterface& stub, const std::string& server_name, const Session& session,
            const ChunkSource& source, const TrackCallbacks& callbacks, const TrackOptions& options);

  absl::StatusOr<TrackSummary> Run();

 private:
  // Writes `attach` and starts the uplink on `attached`; false when the stream or the server is broken.
  bool Attach();
  bool ReadBeforeTimeout(v1::TrackResponse& response);
  // False when the server sent what it never may; status_ says what.
  bool Handle(const v1::TrackResponse& response);
  bool HandlePose(const v1::Pose& message);
  bool Malformed(const std::string& what);
  void Cancel() { context_.TryCancel(); }
  absl::StatusOr<TrackSummary> Result(const grpc::Status& stream_status, bool was_cancelled);
  absl::Status WithProgress(const absl::Status& status) const;

  const std::string server_name_;
  const Session& session_;
  const TrackCallbacks& callbacks_;
  const TrackOptions& options_;
  grpc::ClientContext context_;
  std::unique_ptr<Uplink::Stream> stream_;
  Uplink uplink_;
  absl::Status status_;  // what went wrong on this side of the stream
  uint64_t poses_ = 0;
  uint64_t next_pose_seq_ = 1;
  std::optional<SessionHealth> summary_;
};

}  // namespace evpose::client
