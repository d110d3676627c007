// SPDX-License-Identifier: Apache-2.0

// The times of the searches for the pose of one object (InitializationOptions; core/tracking/README.md, section 3).
#pragma once

#include <cstdint>

#include "core/base/state_io.h"
#include "core/events/event.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {

// Times are sensor times in microseconds: the ends of windows.
class SearchSchedule {
 public:
  // `options` must outlive the schedule.
  explicit SearchSchedule(const InitializationOptions& options) : options_(options), interval_us_(options.retry_us) {}

  bool IsDue(int64_t t_us) const { return t_us >= next_us_; }
  // Whether searches after the publication are left (InitializationOptions::num_repeats).
  bool has_repeats() const { return repeats_left_ > 0; }

  // There are too few events for a search, or a pose was given, which is tested against the events first: the next
  // search is due after InitializationOptions::retry_us.
  void Postpone(int64_t t_us) { next_us_ = t_us + options_.retry_us; }
  // A search without hypotheses has ended: the interval grows by a quarter. `has_moved_edges`: it has found no pose,
  // although there are enough edges with enough motion, so that it took long.
  void OnSearch(int64_t t_us, bool has_moved_edges);
  // The pose of the first hypothesis is published. A given pose needs no repeated search.
  void OnPublication(int64_t t_us, bool is_given);
  // A search beside hypotheses begins. While the published pose is in doubt and no repeats are left, the interval grows
  // by half.
  void OnSearchBesideHypotheses(int64_t t_us, bool is_published);
  // The published pose is TRACKING: the interval is again the one after a publication.
  void OnTracking() { interval_us_ = options_.repeat_us; }
  // The object is lost: the interval is again the first one.
  void OnLoss() { interval_us_ = options_.retry_us; }

  // LoadState() requires the same options.
  void SaveState(StateWriter& writer) const { VisitState(writer, *this); }
  void LoadState(StateReader& reader) { VisitState(reader, *this); }

 private:
  static void VisitState(auto& archive, auto& self) {
    constexpr int64_t kMaxUs = kMaxStateTimeUs;
    archive(InRange(self.next_us_, -kMaxUs, kMaxUs), AtMost(self.interval_us_, kMaxUs),
            AtMost(self.repeats_left_, self.options_.num_repeats));
  }

  const InitializationOptions& options_;
  int64_t next_us_ = 0;      // time of the next search
  int64_t interval_us_ = 0;  // of searches without hypotheses, and of those while a published pose is in doubt
  int repeats_left_ = 0;
};

}  // namespace evpose
