// SPDX-License-Identifier: Apache-2.0

// Hybrid event clustering: the stream cut into windows by sensor time and by count (core/windows/README.md, section 1,
// the paper's Fig. 2).
//
// The rules:
// 1. Time is cut into intervals. A window ends at the first interval boundary at which it holds `min_events`: too few
//    events, and the next interval is merged in. The interval is therefore also the floor on a window's duration, in a
//    flood too. All events count, noise included: measured from 30 to 1000 events, the accuracy hardly depends on N,
//    because the motion prior carries the information on; what depends on it is the rate of the poses.
//    An interval is as long as `interval_us`, and shorter while the image is fast: as long as it takes the fastest
//    object to move by `max_motion_px`, as the caller last said, but no shorter than `min_interval_us`. Motion is
//    estimated within a window, but its acceleration is not.
// 2. A window that lasts `max_duration_us` closes on time whatever it holds, and says so: nothing moved.
// 3. Too many events: an even sample of the whole window stays, drawn by a hash of the event's number in the stream.
//    Neither a span of time nor a place is dropped. (The paper keeps the N events nearest to the middle, which loses
//    the velocity; every second event would favour one side of an edge, because rows are read out from left to right.)
//    It is drawn of ON and OFF events by themselves, of both about as many as far as they came: while a lamp grows
//    brighter or darker, a flood of one polarity comes from everywhere, and the few of the other are the edges'.
// 4. An event before the window's begin (the clock stepped back) joins the open window, at its begin.
// 5. Windows do not overlap: every event is used once, so that the motion prior may carry the information on.
#pragma once

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

struct WindowOptions {
  // Microseconds. The pose period at normal event rates: 1 kHz, and the floor on a window's duration in a flood.
  int64_t interval_us = 1000;
  // Microseconds. The pose period of the fastest images; halving it once more gains nothing that could be measured.
  int64_t min_interval_us = 500;
  // Pixels that the image may move by in an interval. At 3 px per window the rotation's error is a tenth larger.
  double max_motion_px = 2.0;
  // Microseconds. A window closes then even without events: a still object's pose holds at 50 Hz.
  int64_t max_duration_us = 20'000;
  // Events. A window merges intervals until it has as many. Half of what comes in an interval at 0.3 million events per
  // second: above that rate there is a pose for every interval, however unevenly the events come.
  int min_events = 150;
  // Events kept of a window, at most; at least half as many are kept in a flood. Bounds memory and time.
  int max_events = 16'384;
  // Microseconds. A longer silence is one window, not many: bounds the work that a broken time stamp can cause.
  int64_t max_gap_us = 10'000'000;

  // INVALID_ARGUMENT naming the field that is wrong.
  absl::Status Validate() const;
};

// The events of [t_begin_us, t_end_us).
struct EventWindow {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  absl::Span<const WindowEvent> events;  // in order of arrival, times inside the window; valid during the call only
  uint64_t num_events = 0;               // before sampling
  bool closed_on_time = false;           // fewer than min_events came
  ByPolarity events_per_sample = {1.0, 1.0};  // how many each kept one stands for; 1 unless sampled

  int64_t t_mid_us() const { return t_begin_us + (t_end_us - t_begin_us) / 2; }
};

// A stretch of the stream that is in no window.
struct EventGap {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  uint64_t num_events = 0;

  int64_t duration_us() const { return t_end_us - t_begin_us; }
};

// Deterministic: the windows are a function of the events and marks in their order, not of how they are cut into calls.
class EventWindower {
 public:
  using OnWindow = absl::FunctionRef<void(const EventWindow&)>;

  // `options` must be valid.
  EventWindower(const WindowOptions& options, SensorGeometry sensor);

  void Add(absl::Span<const Event> events, OnWindow on_window);
  // The clock has reached t_us: windows that end at or before it close.
  void AdvanceTime(int64_t t_us, OnWindow on_window);
  // These events came, and time went on to t_us, but nobody looks at them: the open window is given up, and the next
  // one begins at the gap's end. The pixels' histories and the numbers of the events go on as if they had been looked
  // at.
  EventGap Skip(absl::Span<const Event> events, int64_t t_us);
  // How fast the fastest object's image moves, px/s: sets the interval from the next window on, so that windows are a
  // function of the past ones. To be called between windows or from on_window.
  void SetImageSpeed(double speed_px_per_s);
  // Closes the open window after its last event, when it has any.
  void Finish(OnWindow on_window);

  // The time up to which the stream has been seen; 0 before the first event or mark.
  int64_t now_us() const { return now_us_; }
  bool has_started() const { return started_; }

  // Into a windower with the same options and sensor; after a failure (reader.status()) it must not be used.
  void SaveState(StateWriter& writer) const;
  void LoadState(StateReader& reader);

 private:
  static void VisitState(auto& archive, auto& self);
  // Of the open window: the numbers in the stream of the events that are kept.
  void SaveIndices(StateWriter& writer) const;
  void LoadIndices(StateReader& reader);
  void Start(int64_t t_us);
  void CloseUntil(int64_t t_us, OnWindow on_window);
  void Close(int64_t t_end_us, OnWindow on_window);
  void Open(int64_t t_begin_us);
  // Those before the boundary, from the first on and a batch at most; returns how many.
  size_t Keep(absl::Span<const Event> events);
  // The same of a batch, of which those marked stay (core/numerics/sampling.h).
  size_t Take(absl::Span<const Event> events, absl::Span<const uint8_t> marks);
  void Thin();
  bool is_sampled() const { return sample_masks_ != std::array<uint64_t, 2>(); }

  const WindowOptions options_;
  int64_t interval_us_;
  bool started_ = false;
  int64_t now_us_ = 0;
  int64_t begin_us_ = 0;
  int64_t boundary_us_ = 0;  // the next interval boundary
  uint64_t stream_index_ = 0;
  uint64_t count_ = 0;
  std::array<uint64_t, 2> sample_masks_ = {};  // by polarity: an event stays when its hash has none of these bits
  PixelHistory history_;                       // of all events, those that are not kept too
  // Of the open window, num_kept_ of max_events and a batch.
  std::vector<WindowEvent> kept_;
  std::vector<uint64_t> indices_;  // of the events kept, in the stream
  size_t num_kept_ = 0;
};

}  // namespace evpose
