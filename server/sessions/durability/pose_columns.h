// SPDX-License-Identifier: Apache-2.0

// Compact form of the poses of a segment: about 140 bytes for each, instead of 500 (PoseColumns in
// proto/evpose/storage/v1/session.proto). All numbers come back to the bit, on every machine.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "server/sessions/types/pose_log.h"

namespace evpose::server {

struct DeflatedColumns {
  std::string bytes;  // empty without poses
  uint32_t inflated_bytes = 0;
};

// Encodes the poses that columns can hold, without their numbers: those without alternatives, with a covariance and a
// twist of single precision, and with a matrix that is a rotation. Calls `on_other` for each of the others. Has
// yield points (core/base/yield_point.h).
DeflatedColumns EncodeColumns(absl::Span<const StoredPose> poses, absl::FunctionRef<void(const StoredPose&)> on_other);
// Returns the poses without numbers, at most `max_poses`. Errors: DATA_LOSS with the reason.
absl::StatusOr<std::vector<StoredPose>> DecodeColumns(absl::string_view bytes, uint32_t inflated_bytes,
                                                      size_t max_poses);

}  // namespace evpose::server
