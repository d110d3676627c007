// SPDX-License-Identifier: Apache-2.0

// The part of RedisGroups that moves buckets.
//
// A bucket that is `moving` or `leaving` does not change, so that its keys can be copied one by one. `leaving` begins
// when all of them are at the other group and its replica. Until then a move can be reverted; from then on it is only
// completed, so that the bucket never is in two places. kRedisRestore does not overwrite what sessions have committed
// at the other group, if two programs move the same bucket.
#include <algorithm>
#include <map>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/random_name.h"
#include "server/stores/redis/redis_groups.h"

namespace evpose::server {
namespace {

absl::Status OtherProgramError(int bucket) {
  return absl::AbortedError(absl::StrCat("another program moves bucket ", bucket, ": try again when it has ended"));
}

}  // namespace

absl::Status RedisGroups::Divide(const std::function<void(const Move&)>& on_moved) {
  EVPOSE_RETURN_IF_ERROR(Refresh());
  const std::vector<Report> reports = AskAll();
  for (const Report& report : reports) EVPOSE_RETURN_IF_ERROR(report.status);
  // Remove the data that an interrupted move left in the source group, before a bucket returns to that group.
  for (size_t i = 0; i < reports.size(); ++i) {
    for (int bucket = 0; bucket < kRedisBuckets; ++bucket) {
      if (reports[i].buckets[static_cast<size_t>(bucket)].state != "moved") continue;
      EVPOSE_RETURN_IF_ERROR(DeleteKeysOf(bucket, *groups_[i]));
    }
  }
  EVPOSE_ASSIGN_OR_RETURN(std::vector<Move> moves, PlanMoves(reports));
  for (Move& move : moves) {
    EVPOSE_RETURN_IF_ERROR(MoveBucket(move));
    on_moved(move);
  }
  return Refresh();
}

absl::StatusOr<std::vector<RedisGroups::Move>> RedisGroups::PlanMoves(const std::vector<Report>& reports) const {
  std::vector<Move> moves;
  std::map<std::string, std::vector<int>> buckets;  // by group, with the moves that have begun
  for (const auto& group : groups_) buckets[group->options.name];
  for (int bucket = 0; bucket < kRedisBuckets; ++bucket) {
    const int place = GroupOf(bucket);
    if (place == kUnknownGroup) return UnknownGroupError(bucket);
    const Bucket& known = reports[static_cast<size_t>(place)].buckets[static_cast<size_t>(bucket)];
    const std::string& name = groups_[static_cast<size_t>(place)]->options.name;
    if (known.state != "here") moves.push_back({.bucket = bucket, .from = name, .to = known.to});
    // Include moves that are complete except for the state "moved" in the source group.
    for (size_t i = 0; i < reports.size(); ++i) {
      const Bucket& other = reports[i].buckets[static_cast<size_t>(bucket)];
      if (static_cast<int>(i) != place && other.state == "leaving") {
        moves.push_back({.bucket = bucket, .from = groups_[i]->options.name, .to = other.to});
      }
    }
    buckets[known.state == "here" ? name : known.to].push_back(bucket);
  }
  const size_t share = kRedisBuckets / buckets.size();
  while (true) {
    const auto is_smaller = [](const auto& a, const auto& b) { return a.second.size() < b.second.size(); };
    const auto [fewest, most] = std::minmax_element(buckets.begin(), buckets.end(), is_smaller);
    if (fewest->second.size() >= share && most->second.size() <= share + 1) return moves;
    moves.push_back({.bucket = most->second.back(), .from = most->first, .to = fewest->first});
    fewest->second.push_back(most->second.back());
    most->second.pop_back();
  }
}

absl::Status RedisGroups::MoveBucket(Move& move) {
  const int from_number = Find(move.from);
  const int to_number = Find(move.to);
  if (to_number == kUnknownGroup || from_number == kUnknownGroup) {
    return absl::FailedPreconditionError(absl::StrCat("bucket ", move.bucket, " moves to the Redis group ", move.to,
                                                      ", which the file of the groups does not name: add it"));
  }
  Group& from = *groups_[static_cast<size_t>(from_number)];
  Group& to = *groups_[static_cast<size_t>(to_number)];
  const std::vector<std::string> state_key = {RedisBucketKey(move.bucket)};
  const auto call = [&state_key](Group& group, const RedisScript& script, std::vector<std::string> arguments) {
    return group.client.CallScript(script, state_key, std::move(arguments), Acknowledgement::kReplica);
  };
  EVPOSE_ASSIGN_OR_RETURN(const std::string mover, RandomHex128());
  // If that fails, too, the next Divide() completes the move. What was copied expires at the other group.
  const auto revert = [&call, &from, &mover](absl::Status error) {
    (void)call(from, kRedisRevertMove, {mover});
    return error;
  };
  const absl::StatusOr<RedisReply> begun_or = call(from, kRedisBeginMove, {move.to, mover});
  if (IsRedisElsewhere(begun_or.status())) return OtherProgramError(move.bucket);
  if (!begun_or.ok()) return revert(begun_or.status());
  const RedisReply& begun = *begun_or;
  if (RedisTextAt(begun.get(), 1) != move.to) return OtherProgramError(move.bucket);
  uint64_t epoch = 0;
  if (!absl::SimpleAtoi(RedisTextAt(begun.get(), 2), &epoch)) {
    return absl::DataLossError(absl::StrCat("the state of bucket ", move.bucket, " is damaged in Redis"));
  }
  const absl::StatusOr<std::vector<std::string>> keys = KeysOf(move.bucket, from);
  absl::Status copied = keys.status();
  if (keys.ok()) copied = CopyKeys(move.bucket, *keys, from, to);
  if (!copied.ok()) return revert(copied);
  move.keys = keys->size();
  EVPOSE_ASSIGN_OR_RETURN(const RedisReply left, call(from, kRedisLeave, {mover}));
  if (RedisText(left.get()) != "OK") return OtherProgramError(move.bucket);
  EVPOSE_RETURN_IF_ERROR(call(to, kRedisArrive, {std::to_string(epoch + 1), RedisTextAt(begun.get(), 3)}).status());
  EVPOSE_RETURN_IF_ERROR(call(from, kRedisMoved, {}).status());
  return DeleteKeysOf(move.bucket, from);
}

absl::Status RedisGroups::CopyKeys(int bucket, const std::vector<std::string>& keys, Group& from, Group& to) {
  for (const std::string& key : keys) {
    auto dump = from.client.Start({"DUMP", key});
    auto ttl = from.client.Start({"PTTL", key});
    const absl::StatusOr<RedisReply> value = dump.get();
    const absl::StatusOr<RedisReply> ttl_ms = ttl.get();
    EVPOSE_RETURN_IF_ERROR(value.status());
    EVPOSE_RETURN_IF_ERROR(ttl_ms.status());
    constexpr int64_t kGone = -2;
    // An index without entries, or Redis has deleted the session.
    if ((*value)->type == REDIS_REPLY_NIL || (*ttl_ms)->integer == kGone) continue;
    const int64_t restored_ttl_ms = (*ttl_ms)->integer < 0 ? 0 : std::max<int64_t>((*ttl_ms)->integer, 1);
    EVPOSE_ASSIGN_OR_RETURN(
        const RedisReply restored,
        to.client.CallScript(kRedisRestore, {RedisBucketKey(bucket), key},
                             {std::to_string(restored_ttl_ms), RedisText(value->get())}, Acknowledgement::kReplica));
    if (RedisText(restored.get()) == "HERE") return absl::OkStatus();
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::string>> RedisGroups::KeysOf(int bucket, Group& group) {
  std::vector<std::string> keys;
  EVPOSE_ASSIGN_OR_RETURN(const RedisReply sessions, group.client.Call({"HKEYS", RedisOwnersKey(bucket)}));
  for (const std::string& name : RedisTexts(sessions.get())) {
    keys.push_back(RedisSessionKey(name));
    keys.push_back(RedisPosesKey(name));
  }
  EVPOSE_ASSIGN_OR_RETURN(const RedisReply models, group.client.Call({"SMEMBERS", RedisModelsKey(bucket)}));
  for (const std::string& member : RedisTexts(models.get())) keys.push_back(RedisModelKey(member));
  keys.insert(keys.end(), {RedisEndedKey(bucket), RedisTenantsKey(bucket), RedisRequestsKey(bucket),
                           RedisLifecycleWritesKey(bucket), RedisModelsKey(bucket), RedisOwnersKey(bucket)});
  return keys;
}

absl::Status RedisGroups::DeleteKeysOf(int bucket, Group& group) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<std::string> keys, KeysOf(bucket, group));
  absl::Status status;
  for (const std::string& key : keys) {
    status.Update(
        group.client.CallScript(kRedisForget, {RedisBucketKey(bucket), key}, {}, Acknowledgement::kMaster).status());
  }
  return status;
}

}  // namespace evpose::server
