// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_models.h"

#include <algorithm>
#include <utility>

#include "core/base/status_macros.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/checked_records.h"
#include "server/stores/redis/redis_keys.h"

namespace evpose::server {
namespace {

std::pair<std::string, std::string> NameAndTenant(const std::string& member) {
  const size_t newline = std::min(member.find('\n'), member.size());
  return {member.substr(0, newline), newline < member.size() ? member.substr(newline + 1) : ""};
}

}  // namespace

absl::StatusOr<std::vector<std::string>> RedisModels::Members() const {
  std::vector<RedisBucketCall> calls;
  for (int bucket = 0; bucket < kRedisBuckets; ++bucket) {
    calls.push_back(ReadBucket(bucket, {"SMEMBERS", RedisModelsKey(bucket)}));
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<RedisReply> sets, groups_.CallThoseThatRespond(calls));
  std::vector<std::string> members;
  for (const RedisReply& set : sets) {
    for (std::string& member : RedisTexts(set.get())) members.push_back(std::move(member));
  }
  std::sort(members.begin(), members.end());
  return members;
}

absl::StatusOr<std::vector<ModelRecord>> RedisModels::List() const {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<std::string> members, Members());
  std::vector<RedisBucketCall> calls;
  for (const std::string& member : members) {
    calls.push_back(ReadBucket(RedisBucketOf(member), {"HGET", RedisModelKey(member), "header"}));
    calls.push_back(ReadBucket(RedisBucketOf(member), {"HSTRLEN", RedisModelKey(member), "bytes"}));
  }
  const std::vector<absl::StatusOr<RedisReply>> replies = groups_.CallAll(calls);
  std::vector<ModelRecord> models;
  for (size_t i = 0; i < members.size(); ++i) {
    const auto &header = replies[2 * i], &size = replies[2 * i + 1];
    EVPOSE_RETURN_IF_ERROR(header.status());
    EVPOSE_RETURN_IF_ERROR(size.status());
    const auto [name, tenant] = NameAndTenant(members[i]);
    auto model = DecodeModelHeader(tenant, name, RedisText(header->get()), static_cast<uint64_t>((*size)->integer));
    if (model.ok()) models.push_back(*std::move(model));
  }
  return models;
}

absl::StatusOr<ModelRecord> RedisModels::Read(const std::string& member) const {
  const auto [name, tenant] = NameAndTenant(member);
  EVPOSE_ASSIGN_OR_RETURN(
      const RedisReply reply,
      groups_.Call(ReadBucket(RedisBucketOf(member), {"HMGET", RedisModelKey(member), "header", "bytes"})));
  if (reply->elements != 2 || reply->element[0]->type == REDIS_REPLY_NIL) return ModelNotFoundError(name);
  const std::string bytes = RedisText(reply->element[1]);
  EVPOSE_ASSIGN_OR_RETURN(ModelRecord model,
                          DecodeModelHeader(tenant, name, RedisText(reply->element[0]), bytes.size()));
  EVPOSE_RETURN_IF_ERROR(DecodeModelBytes(bytes, model));
  return model;
}

absl::StatusOr<bool> RedisModels::Has(const std::string& member) const {
  EVPOSE_ASSIGN_OR_RETURN(
      const RedisReply reply,
      groups_.Call(ReadBucket(RedisBucketOf(member), {"HEXISTS", RedisModelKey(member), "header"})));
  return reply->integer == 1;
}

absl::Status RedisModels::Put(const ModelRecord& model) {
  const std::string member = RedisModelMember(model.tenant, model.name);
  return groups_.Call(OnModel(kRedisPutModel, member, {member, EncodeModelHeader(model), EncodeModelBytes(model)}))
      .status();
}

absl::Status RedisModels::Delete(const std::string& member) {
  return groups_.Call(OnModel(kRedisDeleteModel, member, {member})).status();
}

}  // namespace evpose::server
