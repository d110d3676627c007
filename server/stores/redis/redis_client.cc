// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_client.h"

#include <algorithm>
#include <csignal>
#include <future>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/commit_guard.h"
#include "server/stores/redis/redis_keys.h"

namespace evpose::server {
namespace {

// The maximum size of the commands that are sent before their replies are read. hiredis copies them, so that this
// bounds memory.
constexpr size_t kMaxBatchBytes = 64u << 20;

size_t SizeBytes(const RedisCommand& command) {
  size_t bytes = 0;
  for (const std::string& argument : command) bytes += argument.size();
  return bytes;
}

// hiredis writes to connections that the server may have closed. That must be an error and not end the process.
void BlockSigpipe() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGPIPE);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
}

}  // namespace

RedisClient::RedisClient(const RedisClientOptions& options)
    : options_(options),
      backoff_(options.first_backoff),
      thread_([this](std::vector<Job> jobs) { Process(std::move(jobs)); }) {}

void RedisClient::Push(RedisCommand command, Done done) {
  thread_.Push({.command = std::move(command), .done = std::move(done)});
}

void RedisClient::PushScript(const RedisScript& script, const std::vector<std::string>& keys,
                             std::vector<std::string> arguments, Done done) {
  Job job = {.script = &script, .command = {"EVALSHA", "", std::to_string(keys.size())}, .done = std::move(done)};
  job.command.insert(job.command.end(), keys.begin(), keys.end());
  std::move(arguments.begin(), arguments.end(), std::back_inserter(job.command));
  thread_.Push(std::move(job));
}

absl::StatusOr<RedisReply> RedisClient::Call(RedisCommand command) {
  std::promise<absl::StatusOr<RedisReply>> answer;
  Push(std::move(command), [&answer](absl::StatusOr<RedisReply> reply) { answer.set_value(std::move(reply)); });
  return answer.get_future().get();
}

std::vector<absl::StatusOr<RedisReply>> RedisClient::CallAll(std::vector<RedisCommand> commands) {
  std::vector<std::promise<absl::StatusOr<RedisReply>>> answers(commands.size());
  for (size_t i = 0; i < commands.size(); ++i) {
    Push(std::move(commands[i]),
         [&answer = answers[i]](absl::StatusOr<RedisReply> reply) { answer.set_value(std::move(reply)); });
  }
  std::vector<absl::StatusOr<RedisReply>> replies;
  for (auto& answer : answers) replies.push_back(answer.get_future().get());
  return replies;
}

absl::StatusOr<RedisReply> RedisClient::CallScript(const RedisScript& script, const std::vector<std::string>& keys,
                                                   std::vector<std::string> arguments) {
  std::promise<absl::StatusOr<RedisReply>> answer;
  PushScript(script, keys, std::move(arguments),
             [&answer](absl::StatusOr<RedisReply> reply) { answer.set_value(std::move(reply)); });
  return answer.get_future().get();
}

void RedisClient::Close() {
  thread_.Close();
  connection_.reset();
}

std::vector<std::string> RedisClient::TakeDeletedForRoom() {
  const std::lock_guard lock(mutex_);
  return std::exchange(deleted_for_room_, {});
}

void RedisClient::Process(std::vector<Job> jobs) {
  BlockSigpipe();
  size_t begin = 0;
  while (begin < jobs.size()) {
    if (const absl::Status connected = Connect(); !connected.ok()) {
      for (size_t i = begin; i < jobs.size(); ++i) jobs[i].done(connected);
      return;
    }
    size_t end = begin;
    std::vector<absl::StatusOr<RedisReply>> replies;
    const absl::Status ran = OrUnavailable([&] {
      replies = RunBatch(jobs, begin, end);
      return absl::OkStatus();
    });
    if (!ran.ok()) {
      Disconnect();  // the rest of the replies may still arrive
      for (size_t i = begin; i < jobs.size(); ++i) jobs[i].done(ran);
      return;
    }
    for (size_t i = begin; i < end; ++i) jobs[i].done(RunAgain(jobs[i], std::move(replies[i - begin])));
    if (connection_ != nullptr && connection_->broken()) Disconnect();
    begin = end;
  }
}

std::vector<absl::StatusOr<RedisReply>> RedisClient::RunBatch(std::vector<Job>& jobs, size_t begin, size_t& end) {
  std::vector<RedisCommand> commands;
  end = begin;
  for (size_t bytes = 0; end < jobs.size() && (end == begin || bytes < kMaxBatchBytes); ++end) {
    Job& job = jobs[end];
    if (job.script != nullptr) job.command[1] = digests_[job.script];
    bytes += SizeBytes(job.command);
    commands.push_back(job.command);
  }
  return connection_->Run(commands);
}

absl::StatusOr<RedisReply> RedisClient::RunAgain(const Job& job, absl::StatusOr<RedisReply> reply) {
  if (job.script != nullptr && IsRedisScriptMissing(reply.status())) {
    RedisCommand whole = job.command;
    whole[0] = "EVAL";
    whole[1] = job.script->source;
    reply = connection_->Run(whole);
  }
  while (absl::IsResourceExhausted(reply.status()) && DeleteOldestEnded()) reply = connection_->Run(job.command);
  return reply;
}

absl::Status RedisClient::Connect() {
  if (connection_ != nullptr) return absl::OkStatus();
  if (std::chrono::steady_clock::now() < next_connection_) {
    return absl::UnavailableError(absl::StrCat(options_.address.Printable(), " does not answer: tried a moment ago"));
  }
  absl::StatusOr<std::unique_ptr<RedisConnection>> opened = RedisConnection::Open(options_.address, options_.timeout);
  std::map<const RedisScript*, std::string> digests;
  absl::Status status = opened.status();
  for (const RedisScript* const script : {&kRedisCreate, &kRedisIndex, &kRedisRead, &kRedisCommit, &kRedisDelete,
                                          &kRedisDeleteEnded, &kRedisPutModel, &kRedisDeleteModel}) {
    if (!status.ok()) break;
    const auto loaded = (*opened)->Run({"SCRIPT", "LOAD", script->source});
    status = loaded.status();
    if (loaded.ok()) digests[script] = RedisText(loaded->get());
  }
  if (!status.ok()) {
    Disconnect();
    return status;
  }
  connection_ = *std::move(opened);
  digests_ = std::move(digests);
  backoff_ = options_.first_backoff;
  return absl::OkStatus();
}

void RedisClient::Disconnect() {
  connection_.reset();
  next_connection_ = std::chrono::steady_clock::now() + absl::ToChronoMilliseconds(backoff_);
  backoff_ = std::min(2 * backoff_, options_.longest_backoff);
}

bool RedisClient::DeleteOldestEnded() {
  RedisCommand command = {"EVAL", kRedisDeleteEnded.source, "6"};
  command.insert(command.end(), {kRedisEndedKey, kRedisSessionsKey, kRedisOwnersKey, kRedisTenantsKey,
                                 kRedisRequestsKey, kRedisLifecycleWritesKey});
  command.insert(command.end(), {"+inf", "1", RedisSessionKey(""), RedisPosesKey("")});
  const absl::StatusOr<RedisReply> deleted = connection_->Run(command);
  if (!deleted.ok() || (*deleted)->elements != 1) return false;
  const std::lock_guard lock(mutex_);
  deleted_for_room_.push_back(RedisText((*deleted)->element[0]));
  return true;
}

}  // namespace evpose::server
