// SPDX-License-Identifier: Apache-2.0

// Benchmark on recordings of real sensors: first poses from many start times, tracking from the reference pose, and
// searches for objects that are absent.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/experiments/tracking/real_recordings.h"
#include "core/experiments/tracking/real_score.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {

struct RealBenchOptions {
  std::string directory;           // ReadRealDirectory()
  std::vector<std::string> names;  // names of the recordings; empty: all
  // [1, 1000] start times of each recording, evenly spread over its first three quarters, so that even the last run has
  // a quarter of the recording.
  int num_starts = 20;
  // [1, 1000] start times of each search for an absent object, spread likewise; each goes on to the end of the
  // recording. Whether an object that is similar to the model becomes TRACKING depends on the start time.
  int num_absent_starts = 1;
  // Longest time of a run from a start, microseconds; 0: to the end of the reference. An object that is in view and
  // moves is found within a second, and 2 s show whether it is kept.
  int64_t max_duration_us = 2'000'000;
  // A pose is right if its error is at most this, pixels: twice the error of references that are measured on the same
  // events, and below the distance of neighbouring parallel lines.
  double bound_px = 3.0;
  bool has_starts = true;   // whether the objects of the recordings are tracked
  bool has_foreign = true;  // whether the objects that are absent are searched for
  TrackerOptions tracker;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

// Means and extremes of the runs of a recording; NaN for those without a run that has the figure.
struct RealSummary {
  int num_found = 0;
  int num_wrong = 0;              // number of runs in which the first TRACKING pose is wrong
  double median_wait_s = 0.0;     // median of the runs that are found
  double worst_wait_s = 0.0;      // the longest of the same
  double median_compute_s = 0.0;  // processor time until TRACKING, of the same
  double compute_ratio = 0.0;     // processor time / sensor time of all runs
  double longest_wrong_s = 0.0;   // the longest of all runs
  double right_ratio = 0.0;       // mean
  double doubtful_ratio = 0.0;    // mean
  double ambiguous_ratio = 0.0;   // mean
  uint64_t losses = 0;            // sum
  double median_error_px = 0.0;   // median of the medians
  double p95_error_px = 0.0;      // the worst
};
RealSummary SummariseRealRuns(const std::vector<RealRun>& runs);

// The runs of one recording that shows an object.
struct RealBenchRow {
  std::string recording;
  std::vector<RealRun> searched;  // without a prior, by start time
  std::vector<RealRun> given;     // from the reference pose
};

// The search for an object in a recording of other things, from one start time to its end.
struct ForeignBenchRow {
  std::string recording;
  std::string object;
  RealRun run;  // its tracking_s should be 0
};

struct RealBenchListener {
  std::function<void(const RealBenchRow&)> on_row;
  std::function<void(const ForeignBenchRow&)> on_foreign;
  // Called with the finished share of the work, in [0, 1], and a description of the present step; returning false ends
  // the work with CANCELLED. May be null.
  std::function<bool(double done_ratio, const std::string& text)> on_progress;
};

// Runs the benchmark: first each recording, then each pair of a recording and an object that it does not show, if the
// sensors are of the same size. The camera of a recording without an object is that of the object's folder. The result
// is a function of the options and the files, except for the processor times. Errors: those of Validate(),
// ReadRealDirectory() and ReadRealEvents(); INVALID_ARGUMENT for an unknown name, or for a recording and a reference
// whose times do not overlap.
absl::Status RunRealBench(const RealBenchOptions& options, const RealBenchListener& listener);

}  // namespace evpose
