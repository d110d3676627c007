// SPDX-License-Identifier: Apache-2.0
#include "core/events/event_counts.h"

#include <algorithm>

namespace evpose {

static_assert(EventCounts::kFirstStepUs == int64_t{1} << 10);

void EventCounts::Add(absl::Span<const Event> events) {
  if (events.empty()) return;
  if (counts_.empty()) from_us_ = events[0].t_us;
  for (const Event& event : events) {
    const auto since_us = static_cast<uint64_t>(std::max<int64_t>(event.t_us - from_us_, 0));
    while (since_us >> shift_ >= kMaxIntervals) Double();
    const auto interval = static_cast<size_t>(since_us >> shift_);
    if (interval >= counts_.size()) counts_.resize(interval + 1, 0);
    ++counts_[interval];
  }
}

void EventCounts::Double() {
  for (size_t i = 0; i < counts_.size(); ++i) {
    const uint64_t count = counts_[i];
    if (i % 2 == 0) {
      counts_[i / 2] = count;
    } else {
      counts_[i / 2] += count;
    }
  }
  counts_.resize((counts_.size() + 1) / 2);
  ++shift_;
}

}  // namespace evpose
