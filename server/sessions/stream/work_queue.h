// SPDX-License-Identifier: Apache-2.0

// The items of a session that wait for its worker.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <variant>

#include "core/geometry/rigid_transform.h"
#include "server/sessions/types/stream_data.h"

namespace evpose::server {

using SteadyTime = std::chrono::steady_clock::time_point;

struct PoseReset {
  uint64_t seq = 0;
  uint32_t object_index = 0;
  RigidTransform camera_from_object;
};
struct EndOfInput {};

struct WorkItem {
  uint64_t stream = 0;  // the stream that sent it
  SteadyTime received_at;
  std::variant<EventChunk, PoseReset, EndOfInput> what;

  uint64_t bytes() const;  // size of the payload
  uint64_t seq() const;    // 0 for the end, which has none
  bool is_end() const { return std::holds_alternative<EndOfInput>(what); }
};

// Not thread-safe. The worker takes one item at a time; until it is finished, its bytes belong to the queue.
class WorkQueue {
 public:
  void Push(WorkItem item);
  // Precondition: has_items() and not is_working().
  WorkItem StartNext();
  // The item that StartNext returned last is finished. Precondition: is_working().
  void FinishCurrent();
  // Removes the items that wait. The item in work stays.
  void Clear();

  bool has_items() const { return !items_.empty(); }  // items wait, beside the one in work
  size_t num_items() const { return items_.size(); }
  bool is_working() const { return current_.has_value(); }
  uint64_t bytes() const { return bytes_; }  // of the items that wait and the one in work
  // Receipt of the oldest unfinished item; absent when there is none.
  std::optional<SteadyTime> oldest_received_at() const;

 private:
  struct Current {
    SteadyTime received_at;
    uint64_t bytes = 0;
  };

  std::deque<WorkItem> items_;
  std::optional<Current> current_;
  uint64_t bytes_ = 0;
};

}  // namespace evpose::server
