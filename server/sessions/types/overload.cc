// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/overload.h"

#include <utility>

namespace evpose::server {

bool OverloadGate::MustSkip(const Backlog& backlog) {
  constexpr double kTooMuch = 1.0;
  constexpr double kLittle = 0.5;
  if (is_open_) return false;
  const double limit = skipping_for_.has_value() ? kLittle : kTooMuch;
  const auto reason = [&]() -> std::optional<DropReason> {
    if (backlog.age_ratio > limit) return DropReason::kLag;
    if (backlog.bytes_ratio > limit) return DropReason::kMemory;
    if (backlog.reader_ratio > limit) return DropReason::kReader;
    return std::nullopt;
  }();
  skipping_for_ = reason.has_value() && skipping_for_.has_value() ? skipping_for_ : reason;
  return skipping_for_.has_value();
}

void OverloadGate::AddSkipped(const EventGap& gap) {
  if (!stretch_.has_value()) {
    stretch_ = {0, gap.t_begin_us, gap.t_begin_us, skipping_for_.value_or(DropReason::kLag)};
  }
  stretch_->num_events += gap.num_events;
  stretch_->to_t_us = gap.t_end_us;
}

std::optional<EventsDropped> OverloadGate::EndStretch() { return std::exchange(stretch_, std::nullopt); }

}  // namespace evpose::server
