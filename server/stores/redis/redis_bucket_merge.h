// SPDX-License-Identifier: Apache-2.0

// Reads a sorted list that is divided among the buckets.
#pragma once

#include <array>
#include <cstddef>
#include <deque>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/stores/redis/redis_groups.h"

namespace evpose::server {

struct RedisListEntry {
  double score = 0.0;  // 0 in a list without scores
  std::string text;
  std::string score_text;
};

// Merges the sorted entries of all buckets, on one thread. It first asks all buckets at once, each for a few entries
// more than its share of those that are wanted. When all entries of a bucket have been returned, it asks this bucket
// for more. A list of 50 entries takes one round trip, for which up to 1024 entries are read.
class RedisBucketMerge {
 public:
  // The command that reads at most `count` entries of a bucket after an entry, or from the beginning (null).
  using Command = std::function<RedisCommand(int bucket, const RedisListEntry* after, size_t count)>;
  enum class Scores { kNone, kWith };
  // What happens if the group of a bucket does not respond.
  enum class UnreachableGroup { kIsAnError, kIsSkipped };

  // `groups` must live as long as the object.
  RedisBucketMerge(RedisGroups& groups, Command command, Scores scores, UnreachableGroup unreachable_group)
      : groups_(groups), command_(std::move(command)), scores_(scores), unreachable_group_(unreachable_group) {}

  // The next entries in the order of their scores, then texts; fewer than `max` only at the end.
  absl::StatusOr<std::vector<RedisListEntry>> Next(size_t max);

 private:
  struct Part {
    std::deque<RedisListEntry> entries;  // that were read and not returned yet
    RedisListEntry last;                 // that was read
    bool is_begun = false;
    bool is_complete = false;  // there is nothing behind `last`
  };

  // Reads more of each part that has nothing left but may have more.
  absl::Status Fill(size_t count);
  void Add(Part& part, const redisReply* reply, size_t count) const;

  RedisGroups& groups_;
  const Command command_;
  const Scores scores_;
  const UnreachableGroup unreachable_group_;
  std::array<Part, kRedisBuckets> parts_;
};

}  // namespace evpose::server
