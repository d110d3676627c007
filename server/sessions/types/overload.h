// SPDX-License-Identifier: Apache-2.0

// What a session with OverloadPolicy::kLatest does not track because it has fallen behind.
#pragma once

#include <cstdint>
#include <optional>

#include "core/windows/event_window.h"
#include "server/sessions/types/session_config.h"

namespace evpose::server {

// As the API's.
enum class DropReason { kLag, kMemory, kReader };
struct EventsDropped {
  uint64_t num_events = 0;
  int64_t from_t_us = 0;
  int64_t to_t_us = 0;
  DropReason reason = DropReason::kLag;
};

// How far behind a session is. Each is a share of what is allowed: above 1 is too much.
struct Backlog {
  double age_ratio = 0.0;     // of the oldest chunk that is not worked off, of max_lag
  double bytes_ratio = 0.0;   // that wait, of the credit
  double reader_ratio = 0.0;  // poses and notices that the stream's client has not taken
};

// Not thread-safe.
class OverloadGate {
 public:
  explicit OverloadGate(const SessionConfig& config) : is_open_(config.overload_policy == OverloadPolicy::kBlock) {}

  // Whether the next slice of events is not to be tracked. Once it is too much, slices are skipped until half of what
  // is allowed is left: the poses are then young for a while, and gaps not as frequent as slices. kBlock: never.
  bool MustSkip(const Backlog& backlog);
  void AddSkipped(const EventGap& gap);
  // That of the stretch under way.
  DropReason reason() const { return stretch_.has_value() ? stretch_->reason : DropReason::kLag; }
  // The stretch that was skipped until now: it is over. Nothing when nothing was.
  std::optional<EventsDropped> EndStretch();

 private:
  const bool is_open_;
  std::optional<DropReason> skipping_for_;
  std::optional<EventsDropped> stretch_;
};

}  // namespace evpose::server
