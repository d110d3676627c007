// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_sentinel.h"

#include <string>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "core/base/status_macros.h"

namespace evpose::server {

RedisSentinels::RedisSentinels(const RedisAddress& address, const RedisSentinelOptions& options)
    : address_(address), options_(options) {}

absl::StatusOr<std::unique_ptr<RedisConnection>> RedisSentinels::ConnectToMaster(
    absl::Duration reply_timeout, const std::function<bool()>& gives_up) {
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const Named named, AskAll());
    auto connection = ConnectTo(named);
    if (connection.ok()) (*connection)->SetTimeout(reply_timeout);
    if (!absl::IsUnavailable(connection.status())) return connection;
    StartWithNextSentinel();
    if (gives_up()) return connection;
    absl::SleepFor(options_.pause);
  }
}

absl::StatusOr<RedisSentinels::Named> RedisSentinels::AskAll() {
  std::vector<std::string> reasons;
  std::vector<std::string> without_master;
  for (size_t i = 0; i < address_.sentinels.size(); ++i) {
    const RedisHost& sentinel = address_.sentinels[first_];
    absl::StatusOr<RedisHost> node = Ask(sentinel);
    if (node.ok() && !node->host.empty()) return Named{sentinel, *std::move(node)};
    if (node.ok()) {
      without_master.push_back(sentinel.Printable());
    } else {
      reasons.emplace_back(node.status().message());
    }
    StartWithNextSentinel();
  }
  if (without_master.empty()) {
    return absl::UnavailableError(absl::StrCat("no Sentinel names the master ", address_.master_name, ": ",
                                               absl::StrJoin(reasons, "; "),
                                               ": start the Sentinels, or correct their addresses in --store"));
  }
  std::string others;
  if (!reasons.empty()) others = absl::StrCat(" (", absl::StrJoin(reasons, "; "), ")");
  return absl::UnavailableError(
      absl::StrCat(without_master.size() == 1 ? "the Sentinel " : "the Sentinels ", absl::StrJoin(without_master, ", "),
                   without_master.size() == 1 ? " does" : " do", " not know the master ", address_.master_name, others,
                   ": correct the name in --store, or add `sentinel monitor ", address_.master_name,
                   "` to the configuration of the Sentinels"));
}

absl::StatusOr<RedisHost> RedisSentinels::Ask(const RedisHost& sentinel) const {
  RedisAddress place;
  place.host = sentinel.host;
  place.port = sentinel.port;
  EVPOSE_ASSIGN_OR_RETURN(const auto connection,
                          RedisConnection::Connect(place, sentinel.Printable(), options_.timeout));
  const RedisCommand question = {"SENTINEL", "GET-MASTER-ADDR-BY-NAME", address_.master_name};
  absl::StatusOr<RedisReply> reply = connection->Run(question);
  // Most Sentinels have no password, and would reject one that they do not have.
  if (absl::IsPermissionDenied(reply.status())) {
    EVPOSE_RETURN_IF_ERROR(connection->Authenticate(address_));
    reply = connection->Run(question);
  }
  EVPOSE_RETURN_IF_ERROR(reply.status());
  RedisHost node;
  if ((*reply)->type == REDIS_REPLY_NIL) return node;
  if ((*reply)->elements != 2 || !absl::SimpleAtoi(RedisText((*reply)->element[1]), &node.port)) {
    return absl::UnavailableError(absl::StrCat(sentinel.Printable(), " gives no address: is it a Sentinel?"));
  }
  node.host = RedisText((*reply)->element[0]);
  return node;
}

absl::StatusOr<std::unique_ptr<RedisConnection>> RedisSentinels::ConnectTo(const Named& named) const {
  RedisAddress node = address_;
  node.sentinels.clear();
  node.host = named.node.host;
  node.port = named.node.port;
  const std::string naming = absl::StrCat("the Sentinel ", named.sentinel.Printable(), " names ",
                                          named.node.Printable(), " as the master ", address_.master_name);
  auto connection = RedisConnection::Open(node, options_.timeout);
  if (absl::IsUnavailable(connection.status())) {
    return absl::UnavailableError(absl::StrCat(naming, ": ", connection.status().message()));
  }
  EVPOSE_RETURN_IF_ERROR(connection.status());
  const absl::StatusOr<RedisReply> role = (*connection)->Run({"ROLE"});
  EVPOSE_RETURN_IF_ERROR(role.status());
  const std::string word = (*role)->elements > 0 ? RedisText((*role)->element[0]) : "unknown";
  if (word == "master") return connection;
  return absl::UnavailableError(absl::StrCat(naming, ", but its role is ", word));
}

}  // namespace evpose::server
