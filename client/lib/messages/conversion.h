// SPDX-License-Identifier: Apache-2.0

// Converts between the messages of the API and the types of the public headers. Internal: it includes generated
// headers.
#pragma once

#include <grpcpp/support/status.h>

#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "evpose/types.h"
#include "evpose/v1/admin_service.pb.h"
#include "evpose/v1/error_reason.pb.h"
#include "evpose/v1/event_image.pb.h"
#include "evpose/v1/model_service.pb.h"
#include "evpose/v1/session_service.pb.h"
#include "evpose/v1/track.pb.h"

namespace evpose::client {

// Returns a status with the same code, the message after `context`, with the invalid fields that the server names, and
// the details of client/lib/messages/status_details.h.
absl::Status FromGrpc(const grpc::Status& status, const std::string& context);

// Returns the reason of `status`; ERROR_REASON_UNSPECIFIED for no reason and for one of a later server.
v1::ErrorReason ReasonOf(const absl::Status& status);

// Returns the name of an enumerator of the API without its prefix, for example "TRACKING"; "UNKNOWN" for an unspecified
// enumerator and for one of a later server, which has no name.
std::string_view ApiName(std::string_view name, std::string_view prefix);

v1::ModelFormat ToProto(ModelFormat format);
v1::ModelSurface ToProto(ModelSurface surface);
v1::SessionConfig ToProto(const SessionConfig& config);
v1::RigidTransform ToProto(const Transform& transform);
v1::TrackRequest::ResetPose ToProto(const PoseReset& reset);  // without its number

google::protobuf::Duration ToProto(absl::Duration duration);
absl::Duration FromProto(const google::protobuf::Duration& duration);
ServerInfo FromProto(const v1::ServerInfo& message);
v1::LogLevel ToProto(LogLevel level);
LogLevel FromProto(v1::LogLevel level);  // kOff for a level of a later server
ModelInfo FromProto(const v1::Model& message);
SessionHealth FromProto(const v1::SessionHealth& message);
// Errors of these six: INTERNAL naming the field that violates the API.
absl::StatusOr<Session> FromProto(const v1::Session& message);
absl::StatusOr<Session> FromProto(const v1::CreateSessionResponse& message);  // with the resume token
absl::StatusOr<Transform> FromProto(const v1::RigidTransform& message);
absl::StatusOr<Pose> FromProto(const v1::Pose& message);
absl::StatusOr<EventImage> FromProto(const v1::EventImage& message);  // with unpacked cells
absl::StatusOr<ModelGeometry> FromProto(const v1::ModelGeometry& message);
// Returns nullopt for a kind of a later server.
std::optional<Notice> FromProto(const v1::TrackResponse::Notice& message);

}  // namespace evpose::client
