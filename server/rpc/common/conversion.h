// SPDX-License-Identifier: Apache-2.0

// Conversions between the messages of the API and the types of the server. Errors: INVALID_ARGUMENT with the path of
// the field.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "evpose/v1/admin_service.pb.h"
#include "evpose/v1/model_service.pb.h"
#include "evpose/v1/session_service.pb.h"
#include "server/models/model_registry.h"
#include "server/sessions/session.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/watching/event_image.h"

namespace evpose::server {

absl::StatusOr<SessionConfig> FromProto(const v1::SessionConfig& config);
absl::StatusOr<RigidTransform> FromProto(const v1::RigidTransform& transform, const std::string& field);
absl::StatusOr<ModelReading> FromProto(const v1::UploadModelRequest::Header& header);

// The result has the effective configuration, with defaults filled in.
v1::Session ToProto(const SessionInfo& session);
v1::SessionHealth ToProto(const SessionHealth& health, const SessionConfig& config);
v1::TrackResponse::Notice ToProto(const SessionNotice& notice, const SessionConfig& config);
v1::EventImage ToProto(const EventImage& image, uint64_t num_skipped, const SessionConfig& config);
v1::Pose ToProto(const StoredPose& pose, const SessionConfig& config);
v1::Model ToProto(const ModelInfo& model);
v1::TrackResponse::Attached ToProto(const Attachment& attachment, const SessionLimits& limits);
v1::TrackResponse::Ack ToProto(const SessionAck& ack);
google::protobuf::Duration ToProto(absl::Duration duration);
google::protobuf::Timestamp ToProto(absl::Time time);
// A duration that is out of absl::Duration's range becomes infinite.
absl::Duration FromProto(const google::protobuf::Duration& duration);

}  // namespace evpose::server
