// SPDX-License-Identifier: Apache-2.0

// Serialization of a session's records for the store: configuration, lifecycle record, checkpoint and poses, as
// messages of evpose.storage.v1 (rules of compatibility: proto/evpose/storage/README.md). Numbers are preserved to the
// bit. Errors of all decoding functions: DATA_LOSS with the record and the reason.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "server/sessions/types/pose_log.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/stores/common/store.h"

namespace evpose::server {

std::string EncodeConfig(const SessionConfig& config);
absl::StatusOr<SessionConfig> DecodeConfig(absl::string_view bytes);

std::string EncodeLifecycle(const SessionLifecycle& lifecycle);
absl::StatusOr<SessionLifecycle> DecodeLifecycle(absl::string_view bytes);

// Has yield points (core/base/yield_point.h).
std::string EncodeCheckpoint(SessionCheckpoint checkpoint);
// `num_objects`: the number of objects in the session's configuration.
absl::StatusOr<SessionCheckpoint> DecodeCheckpoint(absl::string_view bytes, size_t num_objects);

}  // namespace evpose::server
