// SPDX-License-Identifier: Apache-2.0

// Overload of a session with OverloadPolicy::kLatest: which events it drops instead of tracking them.
#pragma once

#include <cstdint>
#include <optional>

#include "core/windows/event_window.h"
#include "server/sessions/types/session_config.h"

namespace evpose::server {

// The reasons of the API.
enum class DropReason { kLag, kMemory, kReader };
struct EventsDropped {
  uint64_t num_events = 0;
  int64_t from_t_us = 0;
  int64_t to_t_us = 0;
  DropReason reason = DropReason::kLag;
};

// Backlog of a session, as ratios to the limits: a value above 1 is an overload.
struct Backlog {
  double age_ratio = 0.0;     // age of the oldest unprocessed chunk to max_lag
  double bytes_ratio = 0.0;   // waiting bytes to the credit, or waiting items to their limit
  double reader_ratio = 0.0;  // number of poses that the stream has not sent, to their limit
};

// Not thread-safe.
class OverloadGate {
 public:
  explicit OverloadGate(const SessionConfig& config) : is_open_(config.overload_policy == OverloadPolicy::kBlock) {}

  // Returns true if the events of the next slice must be dropped. Dropping starts when a ratio exceeds 1 and stops when
  // all are at most 0.5: after a gap, poses have little delay for a while, and there are fewer gaps than slices. With
  // kBlock the result is always false.
  bool MustSkip(const Backlog& backlog);
  void AddDropped(const EventGap& gap);
  // The reason for the open gap.
  DropReason reason() const { return gap_.has_value() ? gap_->reason : DropReason::kLag; }
  // Closes and returns the gap; nullopt when no gap is open.
  std::optional<EventsDropped> EndGap();

 private:
  const bool is_open_;
  std::optional<DropReason> dropping_for_;
  std::optional<EventsDropped> gap_;
};

}  // namespace evpose::server
