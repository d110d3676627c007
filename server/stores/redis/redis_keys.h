// SPDX-License-Identifier: Apache-2.0

// The keys of the store in Redis; redis_scripts.h describes their values.
#pragma once

#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace evpose::server {

inline constexpr char kRedisFencingKey[] = "evpose:fencing";
inline constexpr char kRedisSessionsKey[] = "evpose:sessions";
inline constexpr char kRedisOwnersKey[] = "evpose:owners";
inline constexpr char kRedisTenantsKey[] = "evpose:tenants";
inline constexpr char kRedisRequestsKey[] = "evpose:requests";
inline constexpr char kRedisLifecycleWritesKey[] = "evpose:lifecycle_writes";
inline constexpr char kRedisEndedKey[] = "evpose:ended";
inline constexpr char kRedisModelsKey[] = "evpose:models";

inline std::string RedisSessionKey(absl::string_view name) { return absl::StrCat("evpose:session:", name); }
inline std::string RedisPosesKey(absl::string_view name) { return absl::StrCat("evpose:poses:", name); }
inline std::string RedisModelKey(absl::string_view member) { return absl::StrCat("evpose:model:", member); }

}  // namespace evpose::server
