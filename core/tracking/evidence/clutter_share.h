// SPDX-License-Identifier: Apache-2.0

// The share of clutter in the events near the lines of competing poses (core/tracking/README.md, section 2).
#pragma once

#include <cmath>
#include <cstdint>

#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/events/event.h"

namespace evpose {

class ClutterShare {
 public:
  // Sums of the scores of the compared events of a window with respect to one pose. Their mean over uniform clutter is
  // zero, so that clutter contributes as much to `near` as to `beside`.
  struct Scores {
    ByPolarity near{};    // of the events with positive scores
    ByPolarity beside{};  // of the others, without sign

    void Add(double score, size_t polarity) { (score > 0.0 ? near : beside)[polarity] += std::abs(score); }
  };

  // Adds a window, with the scores of each settled pose. Returns the weight of an event, in [0, 1], by polarity: 1
  // minus the share of clutter near the lines, the maximum over the poses.
  ByPolarity Update(absl::Span<const Scores> poses, int64_t t_us);
  // Share of clutter among the events near the lines (both polarities): the minimum over the poses in a window, or a
  // larger one of an earlier window after its decay (README, section 2).
  double ratio() const { return ratio_; }

  static void VisitState(auto& archive, auto& self);

 private:
  double ratio_ = 0.0;
  int64_t updated_us_ = 0;
};

void ClutterShare::VisitState(auto& archive, auto& self) {
  archive(InRange(self.ratio_, 0.0, 1.0), InRange(self.updated_us_, -kMaxStateTimeUs, kMaxStateTimeUs));
}

}  // namespace evpose
