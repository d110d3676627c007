// SPDX-License-Identifier: Apache-2.0
#include "server/stores/common/store.h"

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/random_name.h"

namespace evpose::server {

uint64_t SizeBytes(const std::vector<PoseSegment>& poses) {
  uint64_t bytes = 0;
  for (const PoseSegment& segment : poses) bytes += segment.bytes.size();
  return bytes;
}

uint64_t SizeBytes(const SessionCommit& commit) {
  return (commit.checkpoint.has_value() ? commit.checkpoint->size() : 0) +
         (commit.lifecycle.has_value() ? commit.lifecycle->size() : 0) + SizeBytes(commit.poses);
}

absl::StatusOr<std::string> Store::NewSessionName(absl::string_view /*tenant*/,
                                                  absl::string_view /*request_id*/) const {
  EVPOSE_ASSIGN_OR_RETURN(const std::string id, RandomHex128());
  return absl::StrCat("sessions/", id);
}

}  // namespace evpose::server
