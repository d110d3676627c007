// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/overload.h"

#include <utility>

namespace evpose::server {

bool OverloadGate::MustSkip(const Backlog& backlog) {
  // The gate drops events from the limit of the backlog on until half of it is left: this makes one long gap instead of
  // many short ones.
  constexpr double kStartRatio = 1.0;
  constexpr double kStopRatio = 0.5;
  if (is_open_) return false;
  const double limit = dropping_for_.has_value() ? kStopRatio : kStartRatio;
  const auto reason = [&]() -> std::optional<DropReason> {
    if (backlog.age_ratio > limit) return DropReason::kLag;
    if (backlog.bytes_ratio > limit) return DropReason::kMemory;
    if (backlog.reader_ratio > limit) return DropReason::kReader;
    return std::nullopt;
  }();
  dropping_for_ = reason.has_value() && dropping_for_.has_value() ? dropping_for_ : reason;
  return dropping_for_.has_value();
}

void OverloadGate::AddDropped(const EventGap& gap) {
  if (!gap_.has_value()) {
    gap_ = {0, gap.t_begin_us, gap.t_begin_us, dropping_for_.value_or(DropReason::kLag)};
  }
  gap_->num_events += gap.num_events;
  gap_->to_t_us = gap.t_end_us;
}

std::optional<EventsDropped> OverloadGate::EndGap() { return std::exchange(gap_, std::nullopt); }

}  // namespace evpose::server
