// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/rival_schedule.h"

#include <algorithm>

namespace evpose {

void RivalSchedule::StartRounds(int64_t t_us, RivalPrior prior) {
  next_us_ = t_us;
  rounds_left_ = options_.num_rival_rounds;
  next_rival_ = 0;
  prior_ = prior;
}

RivalSchedule::Group RivalSchedule::NextGroup(int64_t t_us, int count) {
  // The number of rivals depends on the pose, which may have changed since the last group.
  const Group group = {next_rival_, std::max(next_rival_, std::min(count, next_rival_ + kAtOnce)), prior_};
  next_rival_ = group.end;
  if (next_rival_ < count) return group;
  next_rival_ = 0;
  prior_ = RivalPrior::kUnlikely;
  --rounds_left_;
  next_us_ = t_us + options_.rival_interval_us;
  return group;
}

}  // namespace evpose
