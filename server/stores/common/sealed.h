// SPDX-License-Identifier: Apache-2.0

// Records as bytes, sealed by a checksum: what comes back from a disk or another machine is what went there.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// `what` names the bytes, as in "the checkpoint of sessions/a": bytes that stand in the place of others fail, too.
// Appends the CRC-32C of both, 4 bytes.
std::string Seal(absl::string_view what, std::string bytes);
// Errors: DATA_LOSS naming `what`.
absl::StatusOr<std::string> Unseal(absl::string_view what, std::string sealed);
// The checksum that Seal() has appended.
uint32_t SealOf(absl::string_view sealed);

// The names of what is sealed.
std::string CheckpointOf(absl::string_view session);
std::string LifecycleOf(absl::string_view session);
std::string PosesOf(absl::string_view session, uint64_t first_pose_seq, uint64_t last_pose_seq);

// Errors of all Unseal...: DATA_LOSS naming what is damaged.
std::string SealRecord(const SessionRecord& record);
absl::StatusOr<SessionRecord> UnsealRecord(absl::string_view session, std::string sealed);

// All but the bytes.
std::string SealModelHeader(const ModelRecord& model);
absl::StatusOr<ModelRecord> UnsealModelHeader(absl::string_view tenant, absl::string_view name, std::string sealed);
std::string SealModelBytes(const ModelRecord& model);
absl::StatusOr<std::shared_ptr<const std::vector<uint8_t>>> UnsealModelBytes(absl::string_view name,
                                                                             std::string sealed);

// Of the poses of a session, in order: a gap, or the wrong first or last one. Errors: DATA_LOSS naming the session.
absl::Status CheckWhole(absl::string_view session, const std::vector<PoseSegment>& poses, uint64_t first_pose_seq_kept,
                        uint64_t next_pose_seq);

}  // namespace evpose::server
