// SPDX-License-Identifier: Apache-2.0

// How long a tracker reports wrong poses without a break.
#pragma once

#include <algorithm>
#include <cstdint>

namespace evpose {

class WrongInterval {
 public:
  // Adds the next estimate, in order of time.
  void Add(int64_t t_us, bool is_wrong) {
    if (!is_wrong) {
      since_us_ = -1;
      return;
    }
    if (since_us_ < 0) since_us_ = t_us;
    longest_us_ = std::max(longest_us_, t_us - since_us_);
  }
  // The longest time from the first to the last of successive wrong estimates.
  int64_t longest_us() const { return longest_us_; }

 private:
  int64_t since_us_ = -1;  // the first of the present wrong estimates; -1: the latest one was not wrong
  int64_t longest_us_ = 0;
};

}  // namespace evpose
