// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/flash.h"

#include <algorithm>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {

absl::Status FlashOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_rarer_share", max_rarer_share, 0.0, 0.5));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("memory_us", static_cast<double>(memory_us)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("hold_us", static_cast<double>(hold_us), 0.0, 1e9));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_events", min_events));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_sigma", min_sigma, 0.0, 1000.0));
  return CheckRange("min_excess_ratio", min_excess_ratio, 0.0, 1.0);
}

void FlashDetector::Add(const ByPolarity& events, int64_t t_begin_us, int64_t t_end_us) {
  const int64_t duration_us = std::max<int64_t>(0, t_end_us - t_begin_us);
  const double kept = std::max(0.0, 1.0 - static_cast<double>(duration_us) / static_cast<double>(options_.memory_us));
  for (int polarity = 0; polarity < 2; ++polarity) counts_[polarity] = kept * counts_[polarity] + events[polarity];
  const double all = counts_[0] + counts_[1];
  const double rarer = std::min(counts_[0], counts_[1]);
  left_us_ = std::max<int64_t>(0, left_us_ - duration_us);
  if (all >= options_.min_events && rarer < options_.max_rarer_share * all) left_us_ = options_.hold_us;
}

}  // namespace evpose
