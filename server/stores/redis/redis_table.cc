// SPDX-License-Identifier: Apache-2.0

// The part of RedisGroups that finds the buckets.
#include <algorithm>
#include <optional>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "core/base/status_macros.h"
#include "server/runtime/random_name.h"
#include "server/stores/redis/redis_groups.h"

namespace evpose::server {

absl::Status RedisGroups::Refresh() {
  const std::lock_guard one_at_a_time(refresh_mutex_);
  std::vector<Report> reports = AskAll();
  // With a single group, its error is more informative than "the group of the bucket is unknown".
  if (!has_several()) EVPOSE_RETURN_IF_ERROR(reports.front().status);
  EVPOSE_RETURN_IF_ERROR(Join(reports));
  const absl::Status made = MakeMissingBuckets(reports);
  Table table;
  for (size_t bucket = 0; bucket < table.size(); ++bucket) {
    int group = kUnknownGroup;
    uint64_t epoch = 0;
    for (size_t i = 0; i < reports.size(); ++i) {
      const Bucket& known = reports[i].buckets[bucket];
      if (!known.is_place() || known.epoch < epoch) continue;
      group = static_cast<int>(i);
      epoch = known.epoch;
    }
    table[bucket] = group;
  }
  const std::lock_guard lock(mutex_);
  // A group that does not respond may still have its buckets.
  for (size_t bucket = 0; bucket < table.size(); ++bucket) {
    const int before = table_[bucket];
    const bool is_away = before != kUnknownGroup && !reports[static_cast<size_t>(before)].status.ok();
    if (table[bucket] != kUnknownGroup || !is_away) table_[bucket] = table[bucket];
  }
  return made;
}

std::vector<RedisGroups::Report> RedisGroups::AskAll() {
  std::vector<std::vector<std::future<absl::StatusOr<RedisReply>>>> replies;
  for (const auto& group : groups_) {
    std::vector<RedisClient::Command> commands = {{.words = {"HMGET", kRedisStoreKey, "id", "name", "groups"}}};
    for (int bucket = 0; bucket < kRedisBuckets; ++bucket) {
      commands.push_back({.words = {"HMGET", RedisBucketKey(bucket), "state", "to", "epoch"}});
    }
    replies.push_back(group->client.StartAll(std::move(commands)));
  }
  std::vector<Report> reports;
  for (auto& of_group : replies) {
    Report& report = reports.emplace_back();
    for (size_t i = 0; i < of_group.size(); ++i) {
      const absl::StatusOr<RedisReply> reply = of_group[i].get();
      report.status.Update(reply.status());
      if (!reply.ok()) continue;
      const redisReply* const fields = reply->get();
      if (i == 0) {
        report.id = RedisTextAt(fields, 0);
        report.name = RedisTextAt(fields, 1);
        report.names_at_first = RedisTextAt(fields, 2);
        continue;
      }
      Bucket& bucket = report.buckets[i - 1];
      bucket.state = RedisTextAt(fields, 0);
      bucket.to = RedisTextAt(fields, 1);
      (void)absl::SimpleAtoi(RedisTextAt(fields, 2), &bucket.epoch);
    }
    if (!report.status.ok()) report = {.status = report.status};
  }
  return reports;
}

absl::Status RedisGroups::Join(std::vector<Report>& reports) {
  if (std::all_of(reports.begin(), reports.end(), [](const Report& report) { return report.id.empty(); })) {
    EVPOSE_RETURN_IF_ERROR(CreateStore(reports));
  }
  const auto member = std::find_if(reports.begin(), reports.end(), [](const Report& one) { return !one.id.empty(); });
  const Group& of_member = *groups_[static_cast<size_t>(member - reports.begin())];
  const std::string id = member->id;
  for (size_t i = 0; i < reports.size(); ++i) {
    Report& report = reports[i];
    Group& group = *groups_[i];
    if (!report.status.ok()) continue;
    if (report.id.empty()) {
      EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply,
                              group.client.CallScript(kRedisJoin, {kRedisStoreKey}, {id, group.options.name, ""},
                                                      Acknowledgement::kReplica));
      report.id = RedisTextAt(reply.get(), 0);
      report.name = RedisTextAt(reply.get(), 1);
      EVPOSE_RETURN_IF_ERROR(
          group.client.Call({"SET", kRedisOldSessionsKey, kRedisOldSessionsText, "NX"}, Acknowledgement::kReplica)
              .status());
    }
    if (report.id != id) {
      return absl::FailedPreconditionError(absl::StrCat(group.Printable(), " and ", of_member.Printable(),
                                                        " belong to different stores: correct the addresses"));
    }
    if (report.name == group.options.name) continue;
    if (!report.name.empty()) {
      return absl::FailedPreconditionError(
          absl::StrCat(group.Printable(), " is the group ", report.name,
                       " of a store with several groups: give --store redis-groups:FILE with this name"));
    }
    // A store that had one group gets further ones.
    EVPOSE_RETURN_IF_ERROR(
        group.client.CallScript(kRedisName, {kRedisStoreKey}, {group.options.name}, Acknowledgement::kReplica)
            .status());
    report.name = report.names_at_first = group.options.name;
  }
  return absl::OkStatus();
}

absl::Status RedisGroups::CreateStore(std::vector<Report>& reports) {
  for (const Report& report : reports) EVPOSE_RETURN_IF_ERROR(report.status);
  // Choose the group with the smallest name: all servers then choose the same one, whatever the order of their files.
  size_t first = 0;
  for (size_t i = 1; i < groups_.size(); ++i) {
    if (groups_[i]->options.name < groups_[first]->options.name) first = i;
  }
  Group& group = *groups_[first];
  EVPOSE_ASSIGN_OR_RETURN(const std::string id, RandomHex128());
  EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply,
                          group.client.CallScript(kRedisJoin, {kRedisStoreKey}, {id, group.options.name, Names()},
                                                  Acknowledgement::kReplica));
  reports[first].id = RedisTextAt(reply.get(), 0);
  reports[first].name = RedisTextAt(reply.get(), 1);
  reports[first].names_at_first = RedisTextAt(reply.get(), 2);
  return group.client.Call({"SET", kRedisOldSessionsKey, kRedisOldSessionsText, "NX"}, Acknowledgement::kReplica)
      .status();
}

absl::Status RedisGroups::MakeMissingBuckets(std::vector<Report>& reports) {
  // A bucket may be in a group that does not respond.
  for (const Report& report : reports) {
    if (!report.status.ok()) return absl::OkStatus();
  }
  std::vector<std::string> names = absl::StrSplit(Names(), ',');
  for (const Report& report : reports) {
    if (!report.names_at_first.empty()) names = absl::StrSplit(report.names_at_first, ',');
  }
  std::vector<std::future<absl::StatusOr<RedisReply>>> made;
  absl::Status status;
  for (size_t bucket = 0; bucket < kRedisBuckets; ++bucket) {
    const bool is_known = std::any_of(reports.begin(), reports.end(),
                                      [bucket](const Report& report) { return report.buckets[bucket].is_place(); });
    if (is_known) continue;
    // The bucket goes to the group of the initial distribution, or to the target of its latest move.
    std::string name = names[bucket % names.size()];
    uint64_t epoch = 1;
    for (const Report& report : reports) {
      if (report.buckets[bucket].epoch < epoch) continue;
      epoch = report.buckets[bucket].epoch + 1;
      name = report.buckets[bucket].to;
    }
    const int group = Find(name);
    if (group == kUnknownGroup) {
      status.Update(
          absl::FailedPreconditionError(absl::StrCat("bucket ", bucket, " of the store is in the Redis group ", name,
                                                     ", which --store redis-groups:FILE does not name: add it")));
      continue;
    }
    made.push_back(groups_[static_cast<size_t>(group)]->client.StartScript(
        kRedisMakeBucket, {RedisBucketKey(static_cast<int>(bucket))}, {std::to_string(epoch)},
        Acknowledgement::kReplica));
    reports[static_cast<size_t>(group)].buckets[bucket] = {.state = "here", .to = "", .epoch = epoch};
  }
  for (auto& reply : made) status.Update(reply.get().status());
  return status;
}

int RedisGroups::Find(absl::string_view name) const {
  for (size_t i = 0; i < groups_.size(); ++i) {
    if (groups_[i]->options.name == name) return static_cast<int>(i);
  }
  return kUnknownGroup;
}

std::string RedisGroups::Names() const {
  std::vector<std::string> names;
  for (const auto& group : groups_) names.push_back(group->options.name);
  std::sort(names.begin(), names.end());
  return absl::StrJoin(names, ",");
}

}  // namespace evpose::server
