// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_records.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/status_macros.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/checked_records.h"
#include "server/stores/redis/redis_client.h"

namespace evpose::server {
namespace {

absl::Status DamagedInRedis(absl::string_view what) {
  return absl::DataLossError(absl::StrCat(what, " is damaged in Redis"));
}

absl::StatusOr<uint64_t> Number(const redisReply* reply, absl::string_view what) {
  uint64_t number = 0;
  if (!absl::SimpleAtoi(RedisText(reply), &number)) return DamagedInRedis(what);
  return number;
}

// Parses an entry of the stream of poses: its ID and its fields.
absl::StatusOr<PoseSegment> ReadSegment(absl::string_view session, const redisReply* entry) {
  PoseSegment segment;
  const bool has_parts = entry->elements == 2 && entry->element[1]->elements == 2;
  const std::vector<std::string> numbers =
      absl::StrSplit(has_parts ? RedisText(entry->element[0]) : std::string(), '-');
  if (numbers.size() != 2 || !absl::SimpleAtoi(numbers[0], &segment.first_pose_seq) ||
      !absl::SimpleAtoi(numbers[1], &segment.last_pose_seq)) {
    return DamagedInRedis(absl::StrCat("the list of poses of ", session));
  }
  EVPOSE_ASSIGN_OR_RETURN(segment.bytes, VerifyChecksum(PosesOf(session, segment.first_pose_seq, segment.last_pose_seq),
                                                        RedisText(entry->element[1]->element[1])));
  return segment;
}

}  // namespace

absl::StatusOr<RedisSession> ParseRedisSession(absl::string_view name, uint64_t after_pose_seq,
                                               const redisReply* reply) {
  if (reply->type == REDIS_REPLY_NIL) return SessionNotFoundError(name);
  const std::string state = absl::StrCat("the state of ", name);
  if (reply->elements != 7) return DamagedInRedis(state);
  RedisSession session;
  EVPOSE_ASSIGN_OR_RETURN(session.fencing_number, Number(reply->element[0], state));
  EVPOSE_ASSIGN_OR_RETURN(session.next_pose_seq, Number(reply->element[1], state));
  EVPOSE_ASSIGN_OR_RETURN(const uint64_t kept, Number(reply->element[2], state));
  EVPOSE_ASSIGN_OR_RETURN(session.stored.record, DecodeRecord(name, RedisText(reply->element[3])));
  EVPOSE_ASSIGN_OR_RETURN(session.stored.lifecycle, VerifyChecksum(LifecycleOf(name), RedisText(reply->element[4])));
  if (reply->element[5]->type != REDIS_REPLY_NIL) {
    EVPOSE_ASSIGN_OR_RETURN(session.stored.checkpoint,
                            VerifyChecksum(CheckpointOf(name), RedisText(reply->element[5])));
  }
  const redisReply* const entries = reply->element[6];
  for (size_t i = 0; i < entries->elements; ++i) {
    EVPOSE_ASSIGN_OR_RETURN(PoseSegment segment, ReadSegment(name, entries->element[i]));
    session.stored.poses.push_back(std::move(segment));
  }
  EVPOSE_RETURN_IF_ERROR(
      CheckWhole(name, session.stored.poses, std::max(kept, after_pose_seq + 1), session.next_pose_seq));
  return session;
}

absl::StatusOr<StoredLifecycle> DecodeStoredLifecycle(absl::string_view name, std::string encoded) {
  EVPOSE_ASSIGN_OR_RETURN(std::string lifecycle, VerifyChecksum(LifecycleOf(name), std::move(encoded)));
  return StoredLifecycle{.name = std::string(name), .lifecycle = std::move(lifecycle)};
}

}  // namespace evpose::server
