// SPDX-License-Identifier: Apache-2.0

// Records with a checksum, which detects damage on a disk or on the way to another machine.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Appends a CRC-32C of `what` and `bytes`, 4 bytes. `what` names the record ("the checkpoint of sessions/a") and is
// part of the checksum, so that an intact record in the place of another one is detected, too.
std::string AddChecksum(absl::string_view what, std::string bytes);
// The same for a copy of `bytes`, which may have many megabytes: there are yield points (core/base/yield_point.h).
std::string CopyWithChecksum(absl::string_view what, absl::string_view bytes);
// Checks and removes the checksum. Errors: DATA_LOSS naming `what`.
absl::StatusOr<std::string> VerifyChecksum(absl::string_view what, std::string encoded);
// Returns the checksum that AddChecksum() has appended; 0 when there are fewer than 4 bytes.
uint32_t ChecksumOf(absl::string_view encoded);

// The names of records, for AddChecksum() and VerifyChecksum().
std::string CheckpointOf(absl::string_view session);
std::string LifecycleOf(absl::string_view session);
std::string PosesOf(absl::string_view session, uint64_t first_pose_seq, uint64_t last_pose_seq);

// The records of proto/evpose/storage/v1. Errors of all Decode functions: DATA_LOSS naming the damaged record.
std::string EncodeRecord(const SessionRecord& record);
absl::StatusOr<SessionRecord> DecodeRecord(absl::string_view session, std::string encoded);

// The header is the model's record without the file and what was derived from it. `encoded_bytes` is the size of the
// other record.
std::string EncodeModelHeader(const ModelRecord& model);
absl::StatusOr<ModelRecord> DecodeModelHeader(absl::string_view tenant, absl::string_view name, std::string encoded,
                                              uint64_t encoded_bytes);
std::string EncodeModelBytes(const ModelRecord& model);
// Adds `bytes` and `prepared` to the decoded header.
absl::Status DecodeModelBytes(const std::string& encoded, ModelRecord& model);

// Checks that the pose segments of a session cover `first_pose_seq_kept` to `next_pose_seq` - 1 without a gap. Errors:
// DATA_LOSS naming the session.
absl::Status CheckWhole(absl::string_view session, const std::vector<PoseSegment>& poses, uint64_t first_pose_seq_kept,
                        uint64_t next_pose_seq);

// True for the status of reading a session that a list omits: it does not exist, or is damaged.
bool IsMissingOrDamaged(const absl::Status& status);

// Appends the message of a status of reading `what` to `damage` if it is DATA_LOSS.
void NoteDamage(absl::string_view what, const absl::Status& status, std::vector<std::string>& damage);

}  // namespace evpose::server
