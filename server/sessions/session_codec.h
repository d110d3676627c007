// SPDX-License-Identifier: Apache-2.0

// What of a session goes to the store, as bytes: its configuration, its lifecycle, its checkpoints, its poses. Bit for
// bit, with a version before each; what is damaged or was written by another version is DATA_LOSS saying what.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "server/sessions/pose_log.h"
#include "server/sessions/session_config.h"
#include "server/sessions/session_state.h"
#include "server/stores/store.h"

namespace evpose::server {

std::string EncodeConfig(const SessionConfig& config);
absl::StatusOr<SessionConfig> DecodeConfig(absl::string_view bytes);

std::string EncodeLifecycle(const SessionLifecycle& lifecycle);
absl::StatusOr<SessionLifecycle> DecodeLifecycle(absl::string_view bytes);

std::string EncodeCheckpoint(const SessionCheckpoint& checkpoint);
// `num_objects` of the session's configuration.
absl::StatusOr<SessionCheckpoint> DecodeCheckpoint(absl::string_view bytes, size_t num_objects);

// `poses` in a row, at least one.
PoseSegment EncodePoses(absl::Span<const StoredPose> poses);
absl::StatusOr<std::vector<StoredPose>> DecodePoses(const PoseSegment& segment, size_t num_objects);

}  // namespace evpose::server
