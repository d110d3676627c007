// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_server_check.h"

#include <cstdio>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "core/base/status_macros.h"
#include "server/stores/redis/redis_keys.h"

namespace evpose::server {
namespace {

// Without permission for INFO version and policy are assumed to be right.
absl::Status CheckRedisInfo(RedisClient& client, absl::string_view server) {
  const auto info = client.Call({"INFO"});
  if (!info.ok()) return absl::IsUnavailable(info.status()) ? info.status() : absl::OkStatus();
  const std::string text = RedisText(info->get());
  bool has_limit = false;
  std::string policy = "noeviction";
  int major = 7;
  int minor = 0;
  for (absl::string_view line : absl::StrSplit(text, "\r\n")) {
    if (absl::ConsumePrefix(&line, "maxmemory:")) has_limit = line != "0";
    if (absl::ConsumePrefix(&line, "maxmemory_policy:")) policy = std::string(line);
    if (absl::ConsumePrefix(&line, "redis_version:"))
      (void)std::sscanf(std::string(line).c_str(), "%d.%d", &major, &minor);
  }
  if (std::pair(major, minor) < std::pair(6, 2)) {
    return absl::FailedPreconditionError(
        absl::StrCat(server, " is Redis ", major, ".", minor, ": the store needs 6.2 or later"));
  }
  if (!has_limit || policy == "noeviction") return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(
      server, " evicts sessions when its memory is full (maxmemory-policy ", policy, "): set it to noeviction"));
}

}  // namespace

absl::Status CheckRedisServer(RedisClient& client, absl::string_view server) {
  EVPOSE_RETURN_IF_ERROR(client.Call({"PING"}, Acknowledgement::kReplica).status());
  EVPOSE_RETURN_IF_ERROR(CheckRedisInfo(client, server));
  EVPOSE_ASSIGN_OR_RETURN(const RedisReply sessions, client.Call({"TYPE", kRedisOldSessionsKey}));
  EVPOSE_ASSIGN_OR_RETURN(const RedisReply models, client.Call({"EXISTS", "evpose:models"}));
  if (RedisText(sessions.get()) != "set" && models->integer == 0) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(server,
                   " has sessions or models of an earlier version of evpose-server, which this version does not read: "
                   "let that version finish them and delete them (redis-cli FLUSHDB), or give --store another Redis or "
                   "another database (redis://HOST:PORT/1)"));
}

}  // namespace evpose::server
