// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/work_queue.h"

#include <utility>

namespace evpose::server {

uint64_t WorkItem::bytes() const {
  const auto* chunk = std::get_if<EventChunk>(&what);
  return chunk == nullptr ? 0 : chunk->payload.size();
}

uint64_t WorkItem::seq() const {
  if (const auto* chunk = std::get_if<EventChunk>(&what)) return chunk->seq;
  if (const auto* reset = std::get_if<PoseReset>(&what)) return reset->seq;
  return 0;
}

void WorkQueue::Push(WorkItem item) {
  bytes_ += item.bytes();
  items_.push_back(std::move(item));
}

WorkItem WorkQueue::StartNext() {
  WorkItem item = std::move(items_.front());
  items_.pop_front();
  current_ = Current{item.received_at, item.bytes()};
  return item;
}

void WorkQueue::FinishCurrent() {
  bytes_ -= current_->bytes;
  current_.reset();
}

void WorkQueue::Clear() {
  items_.clear();
  bytes_ = current_.has_value() ? current_->bytes : 0;
}

std::optional<SteadyTime> WorkQueue::oldest_received_at() const {
  if (current_.has_value()) return current_->received_at;
  if (items_.empty()) return std::nullopt;
  return items_.front().received_at;
}

}  // namespace evpose::server
