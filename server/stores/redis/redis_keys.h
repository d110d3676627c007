// SPDX-License-Identifier: Apache-2.0

// The buckets and keys of the store in Redis; redis_scripts.h describes the values.
//
// Each session and each model belongs to one of 256 buckets. All its keys contain the bucket as their hash tag {bN}, as
// do the indexes of the bucket, so that each script uses the keys of one bucket. A bucket is in one Redis group.
#pragma once

#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace evpose::server {

// The bucket is a part of the names of all keys, so that stored sessions could not be found with another number. It is
// several times that of the groups of a large cluster, so that each group can be given nearly the same share.
inline constexpr int kRedisBuckets = 256;

// What a group knows about the store that it belongs to.
inline constexpr char kRedisStoreKey[] = "evpose:{store}";
// The set of all sessions in the layout without buckets, and as a text the sign that the layout has buckets.
inline constexpr char kRedisOldSessionsKey[] = "evpose:sessions";
inline constexpr char kRedisOldSessionsText[] =
    "the sessions are in buckets: a later version of evpose-server reads them";

// The bucket of a text: FNV-1a with 32 bits, its four bytes combined with exclusive or. The text is the name of a
// session, or RedisRequest() or RedisModelMember(). It never changes, because it decides where a session is found.
int RedisBucketOf(absl::string_view text);

// TENANT\nREQUEST_ID. A session that is created with a request_id has a name of the same bucket.
std::string RedisRequest(absl::string_view tenant, absl::string_view request_id);
// NAME\nTENANT of a model.
std::string RedisModelMember(absl::string_view tenant, absl::string_view name);

// evpose:{bN}:WHAT.
std::string RedisKey(int bucket, absl::string_view what);
// The state of a bucket, the first key of each script.
std::string RedisBucketKey(int bucket);
std::string RedisEndedKey(int bucket);
std::string RedisOwnersKey(int bucket);
std::string RedisTenantsKey(int bucket);
std::string RedisRequestsKey(int bucket);
std::string RedisLifecycleWritesKey(int bucket);
std::string RedisModelsKey(int bucket);
std::string RedisSessionKey(absl::string_view name);
std::string RedisPosesKey(absl::string_view name);
std::string RedisModelKey(absl::string_view member);

// The keys of every script on a session: the state of its bucket, session, poses, ended, owners, tenants, requests,
// lifecycle_writes.
std::vector<std::string> RedisSessionKeys(absl::string_view name);
// The keys of every script on a model: the state of its bucket, model, models.
std::vector<std::string> RedisModelKeys(absl::string_view member);

}  // namespace evpose::server
