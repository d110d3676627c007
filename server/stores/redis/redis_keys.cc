// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_keys.h"

#include <cstdint>

#include "absl/strings/str_cat.h"

namespace evpose::server {

int RedisBucketOf(absl::string_view text) {
  uint32_t hash = 2166136261u;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 16777619u;
  hash ^= hash >> 16;
  return static_cast<int>((hash ^ (hash >> 8)) & 0xFF);
}

std::string RedisRequest(absl::string_view tenant, absl::string_view request_id) {
  return absl::StrCat(tenant, "\n", request_id);
}

std::string RedisModelMember(absl::string_view tenant, absl::string_view name) {
  return absl::StrCat(name, "\n", tenant);
}

std::string RedisKey(int bucket, absl::string_view what) { return absl::StrCat("evpose:{b", bucket, "}:", what); }

std::string RedisBucketKey(int bucket) { return RedisKey(bucket, "bucket"); }
std::string RedisEndedKey(int bucket) { return RedisKey(bucket, "ended"); }
std::string RedisOwnersKey(int bucket) { return RedisKey(bucket, "owners"); }
std::string RedisTenantsKey(int bucket) { return RedisKey(bucket, "tenants"); }
std::string RedisRequestsKey(int bucket) { return RedisKey(bucket, "requests"); }
std::string RedisLifecycleWritesKey(int bucket) { return RedisKey(bucket, "lifecycle_writes"); }
std::string RedisModelsKey(int bucket) { return RedisKey(bucket, "models"); }

std::string RedisSessionKey(absl::string_view name) {
  return RedisKey(RedisBucketOf(name), absl::StrCat("session:", name));
}

std::string RedisPosesKey(absl::string_view name) {
  return RedisKey(RedisBucketOf(name), absl::StrCat("poses:", name));
}

std::string RedisModelKey(absl::string_view member) {
  return RedisKey(RedisBucketOf(member), absl::StrCat("model:", member));
}

std::vector<std::string> RedisSessionKeys(absl::string_view name) {
  const int bucket = RedisBucketOf(name);
  return {RedisBucketKey(bucket), RedisSessionKey(name),   RedisPosesKey(name),      RedisEndedKey(bucket),
          RedisOwnersKey(bucket), RedisTenantsKey(bucket), RedisRequestsKey(bucket), RedisLifecycleWritesKey(bucket)};
}

std::vector<std::string> RedisModelKeys(absl::string_view member) {
  const int bucket = RedisBucketOf(member);
  return {RedisBucketKey(bucket), RedisModelKey(member), RedisModelsKey(bucket)};
}

}  // namespace evpose::server
