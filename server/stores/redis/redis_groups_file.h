// SPDX-License-Identifier: Apache-2.0

// The file that names the Redis groups of a store, for --store redis-groups:FILE.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/redis/redis_address.h"

namespace evpose::server {

inline constexpr char kRedisGroupsPrefix[] = "redis-groups:";

struct RedisGroupAddress {
  std::string name;
  RedisAddress address;
};

// Parses the contents of a file. Each line is `NAME ADDRESS`; a # begins a comment. NAME has 1 to 32 letters, digits
// and hyphens, and is that of the group in the store for ever; ADDRESS has the form of ParseRedisAddress(). An address
// without a password gets `password`. Errors, which never contain a password: INVALID_ARGUMENT, naming the line.
absl::StatusOr<std::vector<RedisGroupAddress>> ParseRedisGroups(absl::string_view text, const std::string& password);

// Reads the file and parses it with ParseRedisGroups(). Errors, which name the file: those of ParseRedisGroups() and of
// ReadFile().
absl::StatusOr<std::vector<RedisGroupAddress>> ReadRedisGroups(const std::string& file, const std::string& password);

}  // namespace evpose::server
