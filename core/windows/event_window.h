// SPDX-License-Identifier: Apache-2.0

// Cuts the event stream into windows by sensor time and by number of events (core/windows/README.md, section 1; Fig. 2
// of the paper).
//
// The rules:
// 1. Time is divided into intervals. A window ends at the first interval boundary at which it holds `min_events`
//    events; with fewer, the next interval is merged into it. One interval is therefore also the minimum duration of a
//    window, at any event rate. All events count, including noise: between 30 and 1000 events the accuracy hardly
//    depends on `min_events`, because the motion prior carries the information from window to window; only the pose
//    rate depends on it.
//    An interval lasts `interval_us`, or less while the image moves fast: the time in which the fastest object moves by
//    `max_motion_px` at the speed that SetImageSpeed() received, but at least `min_interval_us`. The estimate contains
//    the motion within a window, but not its acceleration.
// 2. A window that lasts `max_duration_us` closes regardless of its number of events. With fewer than `min_events`,
//    nothing moved: the edges have swept too few pixels for more events. The window then has the flag
//    `has_few_events`.
// 3. A window with more than `max_events` events is downsampled uniformly, by a hash of each event's number in the
//    stream. The sample covers the whole time span and the whole image. (The paper keeps the N events nearest to the
//    middle, which discards the information on velocity. Every second event would favour one side of an edge, because
//    a sensor reads its rows from left to right.)
//    ON and OFF events are sampled separately, towards equal numbers of both. While the brightness of a lamp changes,
//    the whole image produces events of one polarity; the few events of the other polarity are caused by edges.
// 4. An event before the beginning of the open window (the clock stepped back) is added to this window with the time of
//    its beginning.
// 5. Windows do not overlap. Each event is used once, because the motion prior already carries its information.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/events/event.h"
#include "core/windows/pixel_history.h"

namespace evpose {

// The interval and min_events are validated by windows_test (a window every millisecond above 0.3 million events per
// second), the motion and the durations by the scenarios "fast", "faster" and "rests" of `evpose bench tracking`, and
// max_events by tests/bench/event_rate.sh at 42 to 104 million events per second (core/experiments/RESULTS.md,
// Tracking).
struct WindowOptions {
  // The pose period for which the constants that count windows were chosen, microseconds.
  static constexpr int64_t kUsualIntervalUs = 1000;
  // Length of an interval, microseconds: the pose period at normal event rates (1 kHz), and the minimum duration of a
  // window at any event rate unless the image moves fast.
  int64_t interval_us = kUsualIntervalUs;
  // Length of an interval for the fastest image motion, microseconds. Half of it brought no measurable improvement.
  int64_t min_interval_us = 500;
  // Maximum image motion in an interval, pixels. At 3 px per window the rotation error is a tenth larger.
  double max_motion_px = 2.0;
  // Maximum duration of a window, microseconds; the window then closes even without events. The pose of an object at
  // rest is therefore reported at 50 Hz.
  int64_t max_duration_us = 20'000;
  // Number of events up to which a window merges intervals. This is half the number of events of an interval at 0.3
  // million events per second: above this rate every interval yields a pose, even if the events are unevenly
  // distributed. From 30 to 1000 events per window the accuracy was the same within a few per cent.
  int min_events = 150;
  // Maximum number of events kept per window, which bounds memory and time. Downsampling keeps about half of it, or
  // more.
  int max_events = 8'192;
  // A longer time without events, microseconds, becomes one window instead of many. This bounds the work that a wrong
  // time stamp can cause.
  int64_t max_gap_us = 10'000'000;

  // The options for this number of poses per second, from 1 to 1'000'000, at event rates that give each interval
  // min_events.
  static WindowOptions WithPoseRate(double pose_rate_hz);
  // The number of intervals in kUsualIntervalUs, at least 1: the factor of constants that count windows.
  int64_t intervals_per_usual() const { return std::max<int64_t>(1, kUsualIntervalUs / interval_us); }

  // Error: INVALID_ARGUMENT naming the field that is wrong.
  absl::Status Validate() const;
};

// The events of the time interval [t_begin_us, t_end_us).
struct EventWindow {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  absl::Span<const WindowEvent> events;  // in order of arrival, times inside the window; valid only during the call
  uint64_t num_events = 0;               // number of events before downsampling
  bool has_few_events = false;           // num_events < WindowOptions::min_events
  ByPolarity events_per_sample = {1.0, 1.0};  // number of events that each kept event represents; 1 if all are kept

  int64_t t_mid_us() const { return t_begin_us + (t_end_us - t_begin_us) / 2; }
};

// A part of the stream that belongs to no window.
struct EventGap {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  uint64_t num_events = 0;

  int64_t duration_us() const { return t_end_us - t_begin_us; }
};

// Deterministic: the windows are a function of the sequence of events and clock marks, and do not depend on their
// division into calls.
class EventWindower {
 public:
  using OnWindow = absl::FunctionRef<void(const EventWindow&)>;

  // `options` must be valid.
  EventWindower(const WindowOptions& options, SensorGeometry sensor);

  // Adds events in order of arrival and calls `on_window` for each window that they close.
  void Add(absl::Span<const Event> events, OnWindow on_window);
  // Advances the clock to t_us: closes the windows that end at or before it.
  void AdvanceTime(int64_t t_us, OnWindow on_window);
  // Drops `events` and the open window, and advances the clock to t_us. The next window begins at the end of the
  // returned gap. The history of the pixels and the numbering of the events include the dropped events.
  EventGap Skip(absl::Span<const Event> events, int64_t t_us);
  // Sets the image speed of the fastest object, px/s, which determines the length of intervals from the next window
  // on. To be called between windows or in on_window, so that the windows are a function of the earlier ones.
  void SetImageSpeed(double speed_px_per_s);
  // Closes the open window after its last event, if it has any event.
  void Finish(OnWindow on_window);

  // The latest time of the stream so far; 0 before the first event or clock mark.
  int64_t now_us() const { return now_us_; }
  bool has_started() const { return has_started_; }

  // LoadState() requires the options and the sensor of the saved windower. After a failure (reader.status()) the object
  // must not be used.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  static void VisitState(auto& archive, auto& self);
  // Save and load the stream numbers of the events that the open window keeps.
  void SaveIndices(StateWriter& writer) const;
  void LoadIndices(StateReader& reader);
  void Start(int64_t t_us);
  void CloseUntil(int64_t t_us, OnWindow on_window);
  void Close(int64_t t_end_us, OnWindow on_window);
  void Open(int64_t t_begin_us);
  // Adds the first events to the open window, up to the interval boundary and at most one batch. Returns their number.
  size_t AddBatch(absl::Span<const Event> events);
  // Adds the first events of a batch up to the interval boundary, and keeps those that `marks` selects
  // (core/numerics/sampling.h). Returns the number of events before the boundary.
  size_t AddSampled(absl::Span<const Event> events, absl::Span<const uint8_t> marks);
  // Halves the sampling rate of the polarity with more kept events, and removes the events that it excludes.
  void HalveSample();
  bool is_sampled() const { return sample_masks_[0] != 0 || sample_masks_[1] != 0; }

  const WindowOptions options_;
  int64_t interval_us_;
  bool has_started_ = false;
  int64_t now_us_ = 0;
  int64_t begin_us_ = 0;
  int64_t boundary_us_ = 0;  // the next interval boundary
  uint64_t stream_index_ = 0;
  uint64_t count_ = 0;
  std::array<uint64_t, 2> sample_masks_ = {};  // by polarity; see core/numerics/sampling.h
  PixelHistory history_;                       // includes the events that are not kept
  // The events that the open window keeps: the first num_kept_ elements. Capacity: max_events and one batch.
  std::vector<WindowEvent> kept_;
  std::vector<uint64_t> indices_;  // stream numbers of the kept events
  size_t num_kept_ = 0;
};

}  // namespace evpose
