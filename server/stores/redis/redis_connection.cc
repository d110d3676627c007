// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_connection.h"

#include <sys/time.h>

#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

constexpr absl::string_view kScriptMissing = "NOSCRIPT";
constexpr absl::string_view kElsewhere = "ELSEWHERE";

// Maps an error reply of Redis, whose first word names its kind, to a status.
absl::Status MakeError(const std::string& name, absl::string_view words) {
  const std::string message = absl::StrCat(name, ": ", words);
  if (absl::StartsWith(words, kScriptMissing)) return absl::FailedPreconditionError(words);
  if (absl::StartsWith(words, kElsewhere)) return absl::FailedPreconditionError(words);
  if (absl::StartsWith(words, "OOM")) {
    return absl::ResourceExhaustedError(absl::StrCat(message, ": delete sessions, or give Redis more maxmemory"));
  }
  for (const char* const kind :
       {"NOAUTH", "WRONGPASS", "NOPERM", "ERR invalid password", "ERR AUTH", "ERR Client sent"}) {
    if (absl::StartsWith(words, kind)) {
      return absl::PermissionDeniedError(absl::StrCat(message, ": check the user and password of --store"));
    }
  }
  for (const char* const kind :
       {"LOADING", "BUSY", "MASTERDOWN", "READONLY", "CLUSTERDOWN", "TRYAGAIN", "MISCONF", "NOREPLICAS", "UNBLOCKED"}) {
    if (absl::StartsWith(words, kind)) return absl::UnavailableError(message);
  }
  // Redis 6.2 puts the place in the script before the error of a command in it.
  if (absl::StrContains(words, "-READONLY ") || absl::StrContains(words, "-NOREPLICAS ")) {
    return absl::UnavailableError(message);
  }
  return absl::InternalError(message);
}

}  // namespace

std::string RedisText(const redisReply* reply) {
  return reply->str == nullptr ? std::string() : std::string(reply->str, reply->len);
}

std::string RedisTextAt(const redisReply* list, size_t i) {
  return i < list->elements ? RedisText(list->element[i]) : std::string();
}

std::vector<std::string> RedisTexts(const redisReply* list) {
  std::vector<std::string> texts;
  for (size_t i = 0; i < list->elements; ++i) texts.push_back(RedisText(list->element[i]));
  return texts;
}

bool IsRedisRefusal(const absl::Status& status) {
  return absl::IsUnavailable(status) &&
         (absl::StrContains(status.message(), "READONLY ") || absl::StrContains(status.message(), "NOREPLICAS "));
}

absl::Status RedisElsewhereError(absl::string_view state) {
  return absl::FailedPreconditionError(absl::StrCat(kElsewhere, " ", state));
}

bool IsRedisElsewhere(const absl::Status& status) {
  return absl::IsFailedPrecondition(status) && absl::StartsWith(status.message(), kElsewhere);
}

bool IsRedisScriptMissing(const absl::Status& status) {
  return absl::IsFailedPrecondition(status) && absl::StartsWith(status.message(), kScriptMissing);
}

absl::StatusOr<std::unique_ptr<RedisConnection>> RedisConnection::Connect(const RedisAddress& address, std::string name,
                                                                          absl::Duration timeout) {
  const timeval limit = absl::ToTimeval(timeout);
  redisContext* const context = address.host.empty()
                                    ? redisConnectUnixWithTimeout(address.socket_path.c_str(), limit)
                                    : redisConnectWithTimeout(address.host.c_str(), address.port, limit);
  if (context == nullptr) return absl::ResourceExhaustedError("out of memory");
  std::unique_ptr<RedisConnection> connection(new RedisConnection(std::move(name), context));
  if (connection->broken()) return connection->Broken();
  connection->SetTimeout(timeout);
  return connection;
}

absl::StatusOr<std::unique_ptr<RedisConnection>> RedisConnection::Open(const RedisAddress& address,
                                                                       absl::Duration timeout) {
  EVPOSE_ASSIGN_OR_RETURN(auto connection, Connect(address, address.Printable(), timeout));
  EVPOSE_RETURN_IF_ERROR(connection->Authenticate(address));
  EVPOSE_RETURN_IF_ERROR(connection->Run({"SELECT", std::to_string(address.database)}).status());
  return connection;
}

absl::Status RedisConnection::Authenticate(const RedisAddress& address) {
  if (!address.user.empty()) return Run({"AUTH", address.user, address.password}).status();
  if (!address.password.empty()) return Run({"AUTH", address.password}).status();
  return absl::OkStatus();
}

void RedisConnection::SetTimeout(absl::Duration timeout) { redisSetTimeout(context_.get(), absl::ToTimeval(timeout)); }

std::vector<absl::StatusOr<RedisReply>> RedisConnection::Run(const std::vector<RedisCommand>& commands) {
  for (const RedisCommand& command : commands) {
    std::vector<const char*> arguments;
    std::vector<size_t> sizes;
    for (const std::string& argument : command) {
      arguments.push_back(argument.data());
      sizes.push_back(argument.size());
    }
    redisAppendCommandArgv(context_.get(), static_cast<int>(command.size()), arguments.data(), sizes.data());
  }
  std::vector<absl::StatusOr<RedisReply>> replies;
  for (size_t i = 0; i < commands.size(); ++i) replies.push_back(Read());
  return replies;
}

absl::StatusOr<RedisReply> RedisConnection::Run(const RedisCommand& command) {
  return std::move(Run(std::vector<RedisCommand>{command})[0]);
}

absl::StatusOr<RedisReply> RedisConnection::Read() {
  if (broken()) return Broken();
  void* read = nullptr;
  if (redisGetReply(context_.get(), &read) != REDIS_OK || read == nullptr) return Broken();
  RedisReply reply(static_cast<redisReply*>(read));
  if (reply->type == REDIS_REPLY_ERROR) return MakeError(name_, RedisText(reply.get()));
  return reply;
}

absl::Status RedisConnection::Broken() const {
  const absl::string_view words = context_->errstr;
  return absl::UnavailableError(absl::StrCat(name_, " does not respond: ",
                                             words.empty() || absl::StartsWith(words, "Resource temporarily")
                                                 ? absl::string_view("no response in time")
                                                 : words));
}

}  // namespace evpose::server
