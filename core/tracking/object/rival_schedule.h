// SPDX-License-Identifier: Apache-2.0

// The times of the tests of the generated rivals of a published pose (core/tracking/README.md, section 6).
#pragma once

#include <cstdint>

#include "core/base/state_io.h"
#include "core/events/event.h"
#include "core/tracking/object/rivals.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {

// The rivals are tested in rounds. In each round every rival is tested once, kAtOnce at a time. Times are sensor times
// in microseconds: the ends of windows.
class RivalSchedule {
 public:
  // Generated rivals that are followed together: bounds the cost of a window. Fewer would take longer to test all of
  // them.
  static constexpr int kAtOnce = 3;

  // The rivals [begin, end) of RivalGenerator::RivalsOf(), which are tested together with this prior.
  struct Group {
    int begin = 0;
    int end = 0;
    RivalPrior prior = RivalPrior::kEqual;
  };

  // No test is due before StartRounds(). `options` must outlive the schedule.
  explicit RivalSchedule(const InitializationOptions& options) : options_(options) {}

  // Another pose is published: InitializationOptions::num_rival_rounds rounds begin now. `prior` is that of the rivals
  // of the first round; the later rounds add to its evidence, so that their rivals are unlikely.
  void StartRounds(int64_t t_us, RivalPrior prior);
  bool IsDue(int64_t t_us) const { return rounds_left_ > 0 && t_us >= next_us_; }
  // Returns the next group of `count` rivals. The group with the last rival ends the round: the next one is due after
  // InitializationOptions::rival_interval_us. Requires IsDue(t_us).
  Group NextGroup(int64_t t_us, int count);

  // LoadState() requires the same options.
  void SaveState(StateWriter& writer) const { VisitState(writer, *this); }
  void LoadState(StateReader& reader) { VisitState(reader, *this); }

 private:
  static void VisitState(auto& archive, auto& self) {
    constexpr int64_t kMaxUs = kMaxStateTimeUs;
    archive(InRange(self.next_us_, -kMaxUs, kMaxUs), AtMost(self.rounds_left_, self.options_.num_rival_rounds),
            AtMost(self.next_rival_, RivalGenerator::kMaxRivals), AtMost(self.prior_, RivalPrior::kUnlikely));
  }

  const InitializationOptions& options_;
  int64_t next_us_ = 0;                    // time of the next round, or the beginning of the present one
  int rounds_left_ = 0;                    // with the present one
  int next_rival_ = 0;                     // first rival of the next group of the round
  RivalPrior prior_ = RivalPrior::kEqual;  // of the rivals of the round
};

}  // namespace evpose
