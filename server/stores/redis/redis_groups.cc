// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_groups.h"

#include <algorithm>
#include <chrono>
#include <optional>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/time/clock.h"
#include "core/base/status_macros.h"
#include "server/stores/redis/redis_server_check.h"

namespace evpose::server {
namespace {

// The delay before a bucket that moves is called again.
constexpr absl::Duration kMovePause = absl::Milliseconds(20);

absl::Status MovingError(int bucket) {
  return absl::UnavailableError(
      absl::StrCat("bucket ", bucket, " of the store moves to another Redis group: try again in a moment"));
}

// Appends the commands of a call. A command without a script is followed by a read of the bucket's state. The state
// changes before the data are deleted, so a bucket that is "here" afterwards was complete when the command ran.
void AddCommands(const RedisBucketCall& call, std::vector<RedisClient::Command>& commands) {
  commands.push_back(call.command);
  if (call.command.script == nullptr) commands.push_back({.words = {"HGET", RedisBucketKey(call.bucket), "state"}});
}

// Waits for the reply to a call. `num_received` counts the elements of `sent` that were received before: one for each
// call with a script, and two for each one without, because it is followed by the command that reads the state.
absl::StatusOr<RedisReply> Receive(const RedisBucketCall& call,
                                   std::vector<std::future<absl::StatusOr<RedisReply>>>& sent, size_t& num_received) {
  absl::StatusOr<RedisReply> reply = sent[num_received++].get();
  if (call.command.script != nullptr) return reply;
  const absl::StatusOr<RedisReply> state = sent[num_received++].get();
  EVPOSE_RETURN_IF_ERROR(reply.status());
  EVPOSE_RETURN_IF_ERROR(state.status());
  const std::string text = RedisText(state->get());
  return text == "here" ? std::move(reply) : RedisElsewhereError(text);
}

// Reads the sections `memory` and `cpu` of INFO. The processor time is that of the server itself, with its threads.
StoreUsage UsageOf(const std::string& info) {
  StoreUsage usage;
  double user_s = 0.0, system_s = 0.0;
  int num_times = 0;
  for (const absl::string_view line : absl::StrSplit(info, "\r\n")) {
    const std::pair<absl::string_view, absl::string_view> field = absl::StrSplit(line, absl::MaxSplits(':', 1));
    if (field.first == "used_memory") (void)absl::SimpleAtoi(field.second, &usage.bytes);
    if (field.first == "maxmemory") (void)absl::SimpleAtoi(field.second, &usage.max_bytes);
    if (field.first == "used_cpu_user") num_times += absl::SimpleAtod(field.second, &user_s) ? 1 : 0;
    if (field.first == "used_cpu_sys") num_times += absl::SimpleAtod(field.second, &system_s) ? 1 : 0;
  }
  if (num_times == 2) usage.cpu_s = user_s + system_s;
  return usage;
}

}  // namespace

RedisBucketCall ReadBucket(int bucket, RedisCommand command) {
  return {.bucket = bucket, .command = {.words = std::move(command)}};
}

RedisBucketCall OnSession(const RedisScript& script, absl::string_view name, std::vector<std::string> arguments,
                          Acknowledgement acknowledgement) {
  return {.bucket = RedisBucketOf(name),
          .command = {.words = std::move(arguments),
                      .script = &script,
                      .keys = RedisSessionKeys(name),
                      .acknowledgement = acknowledgement}};
}

RedisBucketCall OnModel(const RedisScript& script, const std::string& member, std::vector<std::string> arguments) {
  return {.bucket = RedisBucketOf(member),
          .command = {.words = std::move(arguments),
                      .script = &script,
                      .keys = RedisModelKeys(member),
                      .acknowledgement = Acknowledgement::kReplica}};
}

std::string RedisGroups::Group::Printable() const {
  const std::string address = options.client.address.Printable();
  return options.name.empty() ? address : absl::StrCat("the Redis group ", options.name, " (", address, ")");
}

RedisGroups::RedisGroups(const std::vector<RedisGroupOptions>& groups)
    : refresher_([this](const std::vector<RefreshRequest>&) {
        is_refreshing_soon_ = false;
        (void)Refresh();  // the next call of a bucket that is not found reports the error
      }) {
  for (const RedisGroupOptions& group : groups) groups_.push_back(std::make_unique<Group>(group));
  const std::lock_guard lock(mutex_);
  table_.fill(kUnknownGroup);
  health_.resize(groups_.size());
  usages_.resize(groups_.size());
}

absl::Status RedisGroups::Open() {
  absl::Status away;
  size_t num_away = 0;
  for (const auto& group : groups_) {
    const absl::Status checked = CheckRedisServer(group->client, group->Printable());
    if (!absl::IsUnavailable(checked)) {
      EVPOSE_RETURN_IF_ERROR(checked);
      continue;
    }
    away = checked;
    if (++num_away == groups_.size()) return away;
  }
  return Refresh();
}

int RedisGroups::GroupOf(int bucket) const {
  const std::lock_guard lock(mutex_);
  return table_[static_cast<size_t>(bucket)];
}

absl::Status RedisGroups::UnknownGroupError(int bucket) const {
  return absl::UnavailableError(
      absl::StrCat("bucket ", bucket, " of the store is in none of the Redis groups that respond: start the others"));
}

absl::StatusOr<RedisReply> RedisGroups::Call(const RedisBucketCall& call) {
  const auto give_up_at = std::chrono::steady_clock::now() + absl::ToChronoMilliseconds(kMoveWait);
  while (true) {
    int group = GroupOf(call.bucket);
    if (group == kUnknownGroup) {
      const absl::Status refreshed = Refresh();
      group = GroupOf(call.bucket);
      if (group == kUnknownGroup) return refreshed.ok() ? UnknownGroupError(call.bucket) : refreshed;
    }
    std::vector<RedisClient::Command> commands;
    AddCommands(call, commands);
    auto sent = groups_[static_cast<size_t>(group)]->client.StartAll(std::move(commands));
    size_t num_received = 0;
    absl::StatusOr<RedisReply> reply = Receive(call, sent, num_received);
    if (!IsRedisElsewhere(reply.status())) return reply;
    if (std::chrono::steady_clock::now() > give_up_at) return MovingError(call.bucket);
    const absl::Status refreshed = Refresh();
    if (GroupOf(call.bucket) != group) continue;
    EVPOSE_RETURN_IF_ERROR(refreshed);
    absl::SleepFor(kMovePause);
  }
}

std::vector<absl::StatusOr<RedisReply>> RedisGroups::CallAll(const std::vector<RedisBucketCall>& calls) {
  Table table;
  {
    const std::lock_guard lock(mutex_);
    table = table_;
  }
  std::vector<std::vector<RedisClient::Command>> commands(groups_.size());  // by group
  for (const RedisBucketCall& call : calls) {
    const int group = table[static_cast<size_t>(call.bucket)];
    if (group != kUnknownGroup) AddCommands(call, commands[static_cast<size_t>(group)]);
  }
  std::vector<std::vector<std::future<absl::StatusOr<RedisReply>>>> sent;
  for (size_t i = 0; i < groups_.size(); ++i) sent.push_back(groups_[i]->client.StartAll(std::move(commands[i])));
  std::vector<size_t> num_received(groups_.size());
  std::vector<absl::StatusOr<RedisReply>> replies;
  for (const RedisBucketCall& call : calls) {
    const int group = table[static_cast<size_t>(call.bucket)];
    if (group == kUnknownGroup) {
      replies.push_back(RedisElsewhereError("unknown"));
      continue;
    }
    const auto number = static_cast<size_t>(group);
    replies.push_back(Receive(call, sent[number], num_received[number]));
  }
  // One refresh serves all buckets that have moved. The group of a bucket is still unknown after it if that group does
  // not respond.
  bool is_refreshed = false;
  for (size_t i = 0; i < calls.size(); ++i) {
    if (!IsRedisElsewhere(replies[i].status())) continue;
    if (!std::exchange(is_refreshed, true)) (void)Refresh();
    if (GroupOf(calls[i].bucket) == kUnknownGroup) {
      replies[i] = UnknownGroupError(calls[i].bucket);
    } else {
      replies[i] = Call(calls[i]);
    }
  }
  return replies;
}

absl::StatusOr<std::vector<RedisReply>> RedisGroups::CallThoseThatRespond(const std::vector<RedisBucketCall>& calls) {
  absl::Status away;
  std::vector<RedisReply> found;
  for (absl::StatusOr<RedisReply>& reply : CallAll(calls)) {
    if (reply.ok()) {
      found.push_back(*std::move(reply));
    } else if (absl::IsUnavailable(reply.status())) {
      away.Update(reply.status());
    } else {
      return reply.status();
    }
  }
  if (found.empty() && !away.ok()) return away;
  return found;
}

void RedisGroups::PushScript(RedisBucketCall call, Done done) {
  const int bucket = call.bucket;
  const int number = GroupOf(bucket);
  if (number == kUnknownGroup) {
    RefreshSoon();
    return groups_.front()->client.Push(
        {"PING"}, [this, bucket, done = std::move(done)](const absl::StatusOr<RedisReply>& reply) mutable {
          done(absl::IsCancelled(reply.status()) ? reply.status() : UnknownGroupError(bucket));
        });
  }
  Group& group = *groups_[static_cast<size_t>(number)];
  const auto begin = std::chrono::steady_clock::now();
  group.client.Push(std::move(call.command),
                    [this, &group, bucket, begin, done = std::move(done)](absl::StatusOr<RedisReply> reply) mutable {
                      if (IsRedisElsewhere(reply.status())) {
                        RefreshSoon();
                        return done(MovingError(bucket));
                      }
                      const auto duration = std::chrono::steady_clock::now() - begin;
                      group.commit_us += static_cast<uint64_t>(absl::ToInt64Microseconds(absl::FromChrono(duration)));
                      ++group.commits;
                      done(std::move(reply));
                    });
}

void RedisGroups::PushNothing(absl::AnyInvocable<void()> done) {
  groups_.front()->client.Push({"PING"},
                               [done = std::move(done)](const absl::StatusOr<RedisReply>&) mutable { done(); });
}

absl::Status RedisGroups::CheckHealth() {
  std::vector<std::future<absl::StatusOr<RedisReply>>> replies;
  for (const auto& group : groups_) replies.push_back(group->client.Start({"PING"}, Acknowledgement::kReplica));
  std::vector<absl::Status> health;
  for (auto& reply : replies) health.push_back(reply.get().status());
  const auto away = std::find_if(health.begin(), health.end(), [](const auto& one) { return !one.ok(); });
  const bool is_one_away = away != health.end();
  const bool responds = std::any_of(health.begin(), health.end(), [](const auto& one) { return one.ok(); });
  const absl::Status all = responds ? absl::OkStatus() : *away;
  {
    const std::lock_guard lock(mutex_);
    health_ = std::move(health);
  }
  // A group that does not respond cannot say that a bucket has moved to another one.
  if (responds && is_one_away) (void)Refresh();
  return all;
}

std::vector<StoreGroup> RedisGroups::groups() const {
  const std::lock_guard lock(mutex_);
  std::vector<StoreGroup> groups;
  for (size_t i = 0; i < groups_.size(); ++i) {
    const Group& group = *groups_[i];
    groups.push_back({.name = group.options.name,
                      .health = health_[i],
                      .usage = usages_[i],
                      .commits = group.commits,
                      .commit_s = static_cast<double>(group.commit_us) / 1e6,
                      .unreplicated_commits = group.client.unreplicated_commits()});
  }
  for (const int group : table_) {
    if (group != kUnknownGroup) ++groups[static_cast<size_t>(group)].parts;
  }
  std::sort(groups.begin(), groups.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  return groups;
}

// nullopt also for a user who may not call INFO.
std::vector<std::optional<StoreUsage>> RedisGroups::Usages() {
  std::vector<std::future<absl::StatusOr<RedisReply>>> replies;
  // Two commands, because versions before Redis 7 accept only one section.
  for (const auto& group : groups_) {
    replies.push_back(group->client.Start({"INFO", "memory"}));
    replies.push_back(group->client.Start({"INFO", "cpu"}));
  }
  std::vector<std::optional<StoreUsage>> usages;
  for (size_t i = 0; i < groups_.size(); ++i) {
    std::optional<StoreUsage>& usage = usages.emplace_back();
    const absl::StatusOr<RedisReply> memory = replies[2 * i].get();
    const absl::StatusOr<RedisReply> cpu = replies[2 * i + 1].get();
    if (memory.ok() && cpu.ok()) usage = UsageOf(absl::StrCat(RedisText(memory->get()), RedisText(cpu->get())));
  }
  const std::lock_guard lock(mutex_);
  return usages_ = std::move(usages);
}

uint64_t RedisGroups::unreplicated_commits() const {
  uint64_t sum = 0;
  for (const auto& group : groups_) sum += group->client.unreplicated_commits();
  return sum;
}

std::vector<std::string> RedisGroups::TakeDeletedForRoom() {
  std::vector<std::string> names;
  for (const auto& group : groups_) {
    for (std::string& name : group->client.TakeDeletedForRoom()) names.push_back(std::move(name));
  }
  return names;
}

void RedisGroups::RefreshSoon() {
  if (!is_refreshing_soon_.exchange(true)) refresher_.Push({});
}

void RedisGroups::Close() {
  for (const auto& group : groups_) group->client.Close();
  refresher_.Close();
}

}  // namespace evpose::server
