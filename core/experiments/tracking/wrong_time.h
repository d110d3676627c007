// SPDX-License-Identifier: Apache-2.0

// How long a tracker reports wrong poses while TRACKING, in all benchmarks.
#pragma once

#include <algorithm>
#include <cstdint>

#include "core/evaluation/evaluate.h"

namespace evpose {

// A pose is valid until the next one, for at most `max_gap_us`.
class WrongTime {
 public:
  explicit WrongTime(int64_t max_gap_us = EvaluationOptions().max_gap_us) : max_gap_us_(max_gap_us) {}

  // Adds the next pose, in order of time. `is_wrong`: it is TRACKING and not right.
  void Add(int64_t t_us, bool is_wrong) {
    End(t_us);
    t_us_ = t_us;
    is_wrong_ = is_wrong;
  }
  // To be called with the end of the run after the last pose.
  void Finish(int64_t end_us) {
    End(end_us);
    is_wrong_ = false;
  }
  // Time with wrong poses, and the longest such time without a break. A break is a pose that is not wrong, or a gap: a
  // time without a valid pose.
  int64_t total_us() const { return total_us_; }
  int64_t longest_us() const { return longest_us_; }

 private:
  // Counts the time of the latest pose, which is followed by one at `next_us`.
  void End(int64_t next_us) {
    if (!is_wrong_) {
      stretch_us_ = 0;
      return;
    }
    const int64_t valid_us = std::clamp<int64_t>(next_us - t_us_, 0, max_gap_us_);
    total_us_ += valid_us;
    stretch_us_ += valid_us;
    longest_us_ = std::max(longest_us_, stretch_us_);
    if (next_us - t_us_ > max_gap_us_) stretch_us_ = 0;
  }

  int64_t max_gap_us_;
  int64_t t_us_ = 0;
  bool is_wrong_ = false;   // the latest pose
  int64_t stretch_us_ = 0;  // the present time without a break
  int64_t total_us_ = 0;
  int64_t longest_us_ = 0;
};

}  // namespace evpose
