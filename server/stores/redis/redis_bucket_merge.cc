// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_bucket_merge.h"

#include <algorithm>
#include <tuple>
#include <utility>

#include "absl/strings/numbers.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

// Least number of entries that a bucket is asked for. A bucket may have more than its share of the wanted entries, and
// a further entry costs less than a further round trip.
constexpr size_t kFewestEntries = 4;

bool IsBefore(const RedisListEntry& a, const RedisListEntry& b) {
  return std::tie(a.score, a.text) < std::tie(b.score, b.text);
}

}  // namespace

absl::StatusOr<std::vector<RedisListEntry>> RedisBucketMerge::Next(size_t max) {
  std::vector<RedisListEntry> merged;
  while (merged.size() < max) {
    // Afterwards the buffer of each part has an entry, unless the part has been read to its end: the smallest first
    // entry is the next one.
    EVPOSE_RETURN_IF_ERROR(Fill(kFewestEntries + 2 * (max - merged.size()) / kRedisBuckets));
    const auto is_later = [this](size_t a, size_t b) {
      return IsBefore(parts_[b].entries.front(), parts_[a].entries.front());
    };
    std::vector<size_t> heap;
    for (size_t i = 0; i < parts_.size(); ++i) {
      if (!parts_[i].entries.empty()) heap.push_back(i);
    }
    if (heap.empty()) break;
    std::make_heap(heap.begin(), heap.end(), is_later);
    while (merged.size() < max && !heap.empty()) {
      std::pop_heap(heap.begin(), heap.end(), is_later);
      Part& part = parts_[heap.back()];
      merged.push_back(std::move(part.entries.front()));
      part.entries.pop_front();
      if (!part.entries.empty()) {
        std::push_heap(heap.begin(), heap.end(), is_later);
        continue;
      }
      heap.pop_back();
      if (!part.is_complete) break;  // the next entry of the list may be an unread one of this part
    }
  }
  return merged;
}

absl::Status RedisBucketMerge::Fill(size_t count) {
  std::vector<size_t> empty;
  std::vector<RedisBucketCall> calls;
  for (size_t i = 0; i < parts_.size(); ++i) {
    Part& part = parts_[i];
    if (!part.entries.empty() || part.is_complete) continue;
    const int bucket = static_cast<int>(i);
    empty.push_back(i);
    calls.push_back(ReadBucket(bucket, command_(bucket, part.is_begun ? &part.last : nullptr, count)));
  }
  const std::vector<absl::StatusOr<RedisReply>> replies = groups_.CallAll(calls);
  const bool skips = unreachable_group_ == UnreachableGroup::kIsSkipped &&
                     std::any_of(replies.begin(), replies.end(), [](const auto& reply) { return reply.ok(); });
  for (size_t i = 0; i < empty.size(); ++i) {
    Part& part = parts_[empty[i]];
    if (replies[i].ok()) {
      Add(part, replies[i]->get(), count);
    } else if (skips && absl::IsUnavailable(replies[i].status())) {
      part.is_complete = true;
    } else {
      return replies[i].status();
    }
  }
  return absl::OkStatus();
}

void RedisBucketMerge::Add(Part& part, const redisReply* reply, size_t count) const {
  const size_t step = scores_ == Scores::kWith ? 2 : 1;
  for (size_t i = 0; i + step <= reply->elements; i += step) {
    RedisListEntry entry = {.text = RedisText(reply->element[i])};
    if (scores_ == Scores::kWith) {
      entry.score_text = RedisText(reply->element[i + 1]);
      (void)absl::SimpleAtod(entry.score_text, &entry.score);
    }
    part.entries.push_back(std::move(entry));
  }
  part.is_begun = true;
  part.is_complete = reply->elements < step * count;
  if (!part.entries.empty()) part.last = part.entries.back();
}

}  // namespace evpose::server
