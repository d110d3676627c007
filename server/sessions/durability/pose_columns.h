// SPDX-License-Identifier: Apache-2.0

// Compact form of the poses of a segment: about 140 bytes for each, instead of 500 (PoseColumns in
// proto/evpose/storage/v1/session.proto). All numbers come back to the bit, on every machine.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "server/sessions/types/pose_log.h"

namespace evpose::server {

// Whether a pose can be stored in columns: it has no alternatives, its covariance and twist are in single precision,
// and its rotation is one.
bool FitsColumns(const StoredPose& pose);

struct DeflatedColumns {
  std::string bytes;
  uint32_t inflated_bytes = 0;
};

// `poses`: at least one; FitsColumns() holds for each. Their numbers are not encoded.
DeflatedColumns EncodeColumns(absl::Span<const StoredPose> poses);
// Returns the poses without numbers, at most `max_poses`. Errors: DATA_LOSS with the reason.
absl::StatusOr<std::vector<StoredPose>> DecodeColumns(absl::string_view bytes, uint32_t inflated_bytes,
                                                      size_t max_poses);

}  // namespace evpose::server
