// SPDX-License-Identifier: Apache-2.0

// Serialization of a session's poses for the store, as session_codec.h.
#pragma once

#include <cstddef>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "server/sessions/types/pose_log.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// `poses`: consecutive, at least one. Has yield points (core/base/yield_point.h).
PoseSegment EncodePoses(absl::Span<const StoredPose> poses);
// `num_objects`: the number of objects in the session's configuration.
absl::StatusOr<std::vector<StoredPose>> DecodePoses(const PoseSegment& segment, size_t num_objects);

}  // namespace evpose::server
