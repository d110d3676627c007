// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/search_schedule.h"

#include <algorithm>

namespace evpose {

void SearchSchedule::OnSearch(int64_t t_us, bool has_moved_edges) {
  const int64_t longest_us = has_moved_edges ? options_.max_no_pose_retry_us : options_.max_retry_us;
  interval_us_ = std::min(longest_us, interval_us_ + interval_us_ / 4 + 1);
  next_us_ = t_us + interval_us_;
}

void SearchSchedule::OnPublication(int64_t t_us, bool is_given) {
  repeats_left_ = is_given ? 0 : options_.num_repeats;
  interval_us_ = options_.repeat_us;
  next_us_ = t_us + options_.repeat_us;
}

void SearchSchedule::OnSearchBesideHypotheses(int64_t t_us, bool is_published) {
  int64_t wait_us = options_.repeat_us;
  if (is_published && repeats_left_ > 0) {
    --repeats_left_;
  } else if (is_published) {
    // In flicker or clutter a right pose can be doubtful for long: the search interval grows, up to the longest delay
    // with which a returning object is to be found.
    wait_us = interval_us_;
    interval_us_ = std::min(options_.max_retry_us, interval_us_ + interval_us_ / 2);
  }
  next_us_ = t_us + wait_us;
}

}  // namespace evpose
