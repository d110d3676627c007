// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_client.h"

#include <algorithm>
#include <csignal>
#include <future>
#include <iterator>
#include <limits>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/status_macros.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/commit_guard.h"
#include "server/stores/redis/redis_keys.h"

namespace evpose::server {
namespace {

// The maximum size of the commands that are sent before their replies are read. hiredis copies them, so that this
// bounds memory.
constexpr size_t kMaxBatchBytes = 64u << 20;

// A replica has one more wait of RedisClientOptions::replica_timeout, which is 1 s by default, for each of these bytes
// of a large command: 10 MB/s on a slow network.
constexpr size_t kBytesOfWait = 10u << 20;

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

RedisCommand WaitCommand(absl::Duration timeout) {
  return {"WAIT", "1", std::to_string(absl::ToInt64Milliseconds(timeout))};
}

}  // namespace

RedisClient::RedisClient(const RedisClientOptions& options)
    : options_(options),
      sentinels_(options.address.sentinels.empty()
                     ? nullptr
                     : std::make_unique<RedisSentinels>(options.address, options.sentinel)),
      backoff_(options.first_backoff),
      thread_([this](std::vector<Job> jobs) { Process(std::move(jobs)); }) {}

RedisClient::Job RedisClient::MakeJob(Command command, Done done) {
  Job job = {.script = command.script, .acknowledgement = command.acknowledgement, .done = std::move(done)};
  if (command.script == nullptr) {
    job.command = std::move(command.words);
    return job;
  }
  job.command = {"EVALSHA", "", std::to_string(command.keys.size())};
  std::move(command.keys.begin(), command.keys.end(), std::back_inserter(job.command));
  std::move(command.words.begin(), command.words.end(), std::back_inserter(job.command));
  return job;
}

std::pair<RedisClient::Job, std::future<absl::StatusOr<RedisReply>>> RedisClient::MakeJobWithReply(Command command) {
  std::promise<absl::StatusOr<RedisReply>> promise;
  auto reply = promise.get_future();
  Done done = [promise = std::move(promise)](absl::StatusOr<RedisReply> received) mutable {
    promise.set_value(std::move(received));
  };
  return {MakeJob(std::move(command), std::move(done)), std::move(reply)};
}

void RedisClient::Push(Command command, Done done) { thread_.Push(MakeJob(std::move(command), std::move(done))); }

void RedisClient::Push(RedisCommand command, Acknowledgement acknowledgement, Done done) {
  Push({.words = std::move(command), .acknowledgement = acknowledgement}, std::move(done));
}

std::future<absl::StatusOr<RedisReply>> RedisClient::StartCommand(Command command) {
  auto [job, reply] = MakeJobWithReply(std::move(command));
  thread_.Push(std::move(job));
  return std::move(reply);
}

std::vector<std::future<absl::StatusOr<RedisReply>>> RedisClient::StartAll(std::vector<Command> commands) {
  std::vector<std::future<absl::StatusOr<RedisReply>>> replies;
  const auto parts = std::make_shared<std::vector<Job>>();
  for (Command& command : commands) {
    auto [job, reply] = MakeJobWithReply(std::move(command));
    parts->push_back(std::move(job));
    replies.push_back(std::move(reply));
  }
  if (parts->empty()) return replies;
  thread_.Push({.done =
                    [parts](const absl::StatusOr<RedisReply>& closed) {
                      for (Job& part : *parts) part.done(closed.status());
                    },
                .parts = parts});
  return replies;
}

std::vector<RedisClient::Job> RedisClient::Expand(std::vector<Job> jobs) {
  std::vector<Job> all;
  for (Job& job : jobs) {
    if (job.parts == nullptr) {
      all.push_back(std::move(job));
    } else {
      std::move(job.parts->begin(), job.parts->end(), std::back_inserter(all));
    }
  }
  return all;
}

std::future<absl::StatusOr<RedisReply>> RedisClient::Start(RedisCommand command, Acknowledgement acknowledgement) {
  return StartCommand({.words = std::move(command), .acknowledgement = acknowledgement});
}

std::future<absl::StatusOr<RedisReply>> RedisClient::StartScript(const RedisScript& script,
                                                                 const std::vector<std::string>& keys,
                                                                 std::vector<std::string> arguments,
                                                                 Acknowledgement acknowledgement) {
  return StartCommand(
      {.words = std::move(arguments), .script = &script, .keys = keys, .acknowledgement = acknowledgement});
}

absl::StatusOr<RedisReply> RedisClient::Call(RedisCommand command, Acknowledgement acknowledgement) {
  return Start(std::move(command), acknowledgement).get();
}

absl::StatusOr<RedisReply> RedisClient::CallScript(const RedisScript& script, const std::vector<std::string>& keys,
                                                   std::vector<std::string> arguments,
                                                   Acknowledgement acknowledgement) {
  return StartScript(script, keys, std::move(arguments), acknowledgement).get();
}

void RedisClient::Close() {
  is_closing_ = true;
  thread_.Close();
  connection_.reset();
}

std::vector<std::string> RedisClient::TakeDeletedForRoom() {
  const std::lock_guard lock(mutex_);
  return std::exchange(deleted_for_room_, {});
}

void RedisClient::Process(std::vector<Job> waiting) {
  BlockSigpipe();
  std::vector<Job> jobs = Expand(std::move(waiting));
  wait_until_ = std::chrono::steady_clock::now();
  if (!skips_failover_wait_) wait_until_ += absl::ToChronoMilliseconds(options_.sentinel.failover_wait);
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
    DisconnectIfNeeded(replies);
    begin = Deliver(jobs, begin, end, std::move(replies));
    if (begin < end) absl::SleepFor(sentinels_->pause());
  }
}

size_t RedisClient::Deliver(std::vector<Job>& jobs, size_t begin, size_t end,
                            std::vector<absl::StatusOr<RedisReply>> replies) {
  const bool may_wait = sentinels_ != nullptr && MayWait();
  for (size_t i = begin; i < end; ++i) {
    absl::StatusOr<RedisReply>& reply = replies[i - begin];
    if (IsRedisRefusal(reply.status())) {
      if (may_wait) continue;
      skips_failover_wait_ = true;
    }
    if (AwaitsReplica(jobs[i]) && reply.ok()) skips_failover_wait_ = false;
    jobs[i].done(std::move(reply));
    jobs[i].done = nullptr;
  }
  size_t first_refused = end;
  for (size_t i = end; i-- > begin;) {
    if (jobs[i].done != nullptr) std::swap(jobs[i], jobs[--first_refused]);
  }
  return first_refused;
}

std::vector<absl::StatusOr<RedisReply>> RedisClient::RunBatch(std::vector<Job>& jobs, size_t begin, size_t& end) {
  std::vector<RedisCommand> commands;
  bool awaits_replica = false;
  size_t bytes = 0;
  for (end = begin; end < jobs.size() && (end == begin || bytes < kMaxBatchBytes); ++end) {
    Job& job = jobs[end];
    if (job.script != nullptr) job.command[1] = digests_[job.script];
    bytes += SizeBytes(job.command);
    commands.push_back(job.command);
    awaits_replica |= AwaitsReplica(job);
  }
  // One acknowledgement covers the whole batch.
  if (awaits_replica) commands.push_back(WaitCommand(options_.replica_timeout));
  std::vector<absl::StatusOr<RedisReply>> replies = connection_->Run(commands);
  absl::Status acknowledged;
  if (awaits_replica) {
    acknowledged = AwaitReplica(std::move(replies.back()), bytes);
    replies.pop_back();
  }
  for (size_t i = 0; i < replies.size(); ++i) {
    const Job& job = jobs[begin + i];
    const bool runs_again = RunAgain(job, replies[i]);
    if (!AwaitsReplica(job) || !replies[i].ok()) continue;
    if (runs_again) {
      acknowledged = AwaitReplica(connection_->Run(WaitCommand(options_.replica_timeout)), SizeBytes(job.command));
    }
    if (acknowledged.ok()) continue;
    replies[i] = acknowledged;
    if (job.script != nullptr) ++unreplicated_commits_;
  }
  return replies;
}

bool RedisClient::AwaitsReplica(const Job& job) const {
  return sentinels_ != nullptr && job.acknowledgement == Acknowledgement::kReplica;
}

absl::Status RedisClient::AwaitReplica(absl::StatusOr<RedisReply> reply, size_t bytes) {
  for (size_t waits = bytes / kBytesOfWait; waits > 0 && reply.ok() && (*reply)->integer == 0; --waits) {
    reply = connection_->Run(WaitCommand(options_.replica_timeout));
  }
  EVPOSE_RETURN_IF_ERROR(reply.status());
  if ((*reply)->integer >= 1) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("no replica of ", options_.address.master_name, " has acknowledged the last writes within ",
                   absl::FormatDuration(options_.replica_timeout),
                   ": start a replica, or read its log to see why it does not follow the master"));
}

bool RedisClient::RunAgain(const Job& job, absl::StatusOr<RedisReply>& reply) {
  bool runs_again = false;
  if (job.script != nullptr && IsRedisScriptMissing(reply.status())) {
    RedisCommand whole = job.command;
    whole[0] = "EVAL";
    whole[1] = job.script->source;
    reply = connection_->Run(whole);
    runs_again = true;
  }
  while (absl::IsResourceExhausted(reply.status()) && DeleteOldestEnded()) {
    reply = connection_->Run(job.command);
    runs_again = true;
  }
  return runs_again;
}

absl::Status RedisClient::Connect() {
  if (connection_ != nullptr) return absl::OkStatus();
  if (std::chrono::steady_clock::now() < next_connection_) {
    return absl::UnavailableError(absl::StrCat(options_.address.Printable(), " does not respond: tried a moment ago"));
  }
  absl::StatusOr<std::unique_ptr<RedisConnection>> opened = OpenConnection();
  std::map<const RedisScript*, std::string> digests;
  absl::Status status = opened.status();
  for (const RedisScript* const script : AllRedisScripts()) {
    if (!status.ok()) break;
    const auto loaded = (*opened)->Run({"SCRIPT", "LOAD", script->source});
    status = loaded.status();
    if (loaded.ok()) digests[script] = RedisText(loaded->get());
  }
  if (!status.ok()) {
    skips_failover_wait_ = true;
    Disconnect();
    return status;
  }
  connection_ = *std::move(opened);
  digests_ = std::move(digests);
  backoff_ = options_.first_backoff;
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<RedisConnection>> RedisClient::OpenConnection() {
  if (sentinels_ == nullptr) return RedisConnection::Open(options_.address, options_.timeout);
  return sentinels_->ConnectToMaster(options_.timeout, [this] { return !MayWait(); });
}

void RedisClient::DisconnectIfNeeded(const std::vector<absl::StatusOr<RedisReply>>& replies) {
  if (connection_->broken()) return Disconnect();
  if (sentinels_ == nullptr) return;
  // READONLY, or no replica: the node may have been replaced as the master without the connection being closed.
  const bool is_doubtful = std::any_of(replies.begin(), replies.end(),
                                       [](const auto& reply) { return absl::IsUnavailable(reply.status()); });
  if (!is_doubtful) return;
  connection_.reset();
  sentinels_->StartWithNextSentinel();
}

void RedisClient::Disconnect() {
  connection_.reset();
  next_connection_ = std::chrono::steady_clock::now() + absl::ToChronoMilliseconds(backoff_);
  backoff_ = std::min(2 * backoff_, options_.longest_backoff);
}

bool RedisClient::DeleteOldestEnded() {
  std::vector<RedisCommand> commands;
  for (int bucket = 0; bucket < kRedisBuckets; ++bucket) {
    commands.push_back({"ZRANGE", RedisEndedKey(bucket), "0", "0", "WITHSCORES"});
  }
  std::string name;
  double earliest_us = std::numeric_limits<double>::infinity();
  for (const absl::StatusOr<RedisReply>& reply : connection_->Run(commands)) {
    double ended_at_us = 0.0;
    if (!reply.ok() || (*reply)->elements != 2) continue;
    if (!absl::SimpleAtod(RedisText((*reply)->element[1]), &ended_at_us) || ended_at_us >= earliest_us) continue;
    earliest_us = ended_at_us;
    name = RedisText((*reply)->element[0]);
  }
  if (name.empty()) return false;
  const std::vector<std::string> keys = RedisSessionKeys(name);
  RedisCommand command = {"EVAL", kRedisDeleteEnded.source, std::to_string(keys.size())};
  command.insert(command.end(), keys.begin(), keys.end());
  command.insert(command.end(), {name, "+inf"});
  const absl::StatusOr<RedisReply> deleted = connection_->Run(command);
  if (!deleted.ok() || RedisText(deleted->get()) != "OK") return false;
  const std::lock_guard lock(mutex_);
  deleted_for_room_.push_back(std::move(name));
  return true;
}

}  // namespace evpose::server
