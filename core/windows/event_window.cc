// SPDX-License-Identifier: Apache-2.0
#include "core/windows/event_window.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/numerics/prefetch.h"
#include "core/numerics/sampling.h"
#include "core/windows/window_event_state.h"

namespace evpose {
namespace {

// Number of events processed together: enough for vector instructions in the hash, and few enough to stay in the L1
// cache.
constexpr size_t kBatch = 256;

constexpr auto PolarityOf = [](const Event& event) -> size_t { return event.polarity != 0 ? 1 : 0; };

}  // namespace

WindowOptions WindowOptions::WithPoseRate(double pose_rate_hz) {
  WindowOptions options;
  options.interval_us = static_cast<int64_t>(std::round(1e6 / pose_rate_hz));
  options.min_interval_us = std::min(options.min_interval_us, options.interval_us);
  return options;
}

absl::Status WindowOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckPositive("interval_us", static_cast<double>(interval_us)));
  EVPOSE_RETURN_IF_ERROR(
      CheckRange("min_interval_us", static_cast<double>(min_interval_us), 1, static_cast<double>(interval_us)));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("max_motion_px", max_motion_px));
  if (max_duration_us < interval_us) {
    return absl::InvalidArgumentError(absl::StrCat("max_duration_us (", max_duration_us,
                                                   ") must not be shorter than interval_us (", interval_us, ")"));
  }
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_events", static_cast<double>(min_events)));
  if (max_events < 2 || max_events < min_events) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_events (", max_events, ") must be at least 2 and at least min_events (", min_events, ")"));
  }
  if (max_gap_us < max_duration_us) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_gap_us (", max_gap_us, ") must not be shorter than max_duration_us (", max_duration_us, ")"));
  }
  return absl::OkStatus();
}

EventWindower::EventWindower(const WindowOptions& options, SensorGeometry sensor)
    : options_(options),
      interval_us_(options.interval_us),
      history_(sensor),
      kept_(options_.max_events + kBatch),
      indices_(options_.max_events + kBatch) {}

void EventWindower::Add(absl::Span<const Event> events, OnWindow on_window) {
  while (!events.empty()) {
    const int64_t t_us = events.front().t_us;
    if (!has_started_) Start(t_us);
    if (t_us >= boundary_us_) CloseUntil(t_us, on_window);
    events.remove_prefix(AddBatch(events));
  }
}

void EventWindower::AdvanceTime(int64_t t_us, OnWindow on_window) {
  if (!has_started_) Start(t_us);
  if (t_us >= boundary_us_) CloseUntil(t_us, on_window);
  now_us_ = std::max(now_us_, t_us);
}

EventGap EventWindower::Skip(absl::Span<const Event> events, int64_t t_us) {
  if (!has_started_) Start(events.empty() ? t_us : events.front().t_us);
  now_us_ = std::max(now_us_, t_us);
  for (const Event& event : events) {
    now_us_ = std::max(now_us_, event.t_us);
    history_.Exchange(event);
  }
  stream_index_ += events.size();
  const EventGap gap = {begin_us_, std::max(begin_us_, now_us_), count_ + events.size()};
  Open(gap.t_end_us);
  return gap;
}

void EventWindower::SetImageSpeed(double speed_px_per_s) {
  const double longest_us = static_cast<double>(options_.interval_us);
  const double moving_us = speed_px_per_s > 0.0 ? 1e6 * options_.max_motion_px / speed_px_per_s : longest_us;
  interval_us_ = std::max(options_.min_interval_us, static_cast<int64_t>(std::min(longest_us, moving_us)));
}

void EventWindower::Finish(OnWindow on_window) {
  if (!has_started_ || count_ == 0) return;
  Close(std::max(now_us_, begin_us_) + 1, on_window);
}

void EventWindower::Start(int64_t t_us) {
  has_started_ = true;
  now_us_ = t_us;
  Open(t_us);
}

void EventWindower::CloseUntil(int64_t t_us, OnWindow on_window) {
  if (t_us - begin_us_ > options_.max_gap_us) {
    if (count_ > 0) Close(std::max(now_us_ + 1, boundary_us_), on_window);
    Close(t_us, on_window);
    return;
  }
  while (t_us >= boundary_us_) {
    const int64_t deadline_us = begin_us_ + options_.max_duration_us;
    if (count_ >= static_cast<uint64_t>(options_.min_events) || boundary_us_ >= deadline_us) {
      Close(boundary_us_, on_window);
    } else {
      boundary_us_ = std::min(boundary_us_ + interval_us_, deadline_us);
    }
  }
}

void EventWindower::Close(int64_t t_end_us, OnWindow on_window) {
  EventWindow window;
  window.t_begin_us = begin_us_;
  window.t_end_us = t_end_us;
  window.events = absl::MakeConstSpan(kept_).first(num_kept_);
  window.num_events = count_;
  window.has_few_events = count_ < static_cast<uint64_t>(options_.min_events);
  for (int polarity = 0; polarity < 2; ++polarity) {
    window.events_per_sample[polarity] = static_cast<double>(sample_masks_[polarity]) + 1.0;
  }
  on_window(window);
  Open(t_end_us);
}

void EventWindower::Open(int64_t t_begin_us) {
  begin_us_ = t_begin_us;
  boundary_us_ = t_begin_us + interval_us_;
  count_ = 0;
  sample_masks_ = {};
  num_kept_ = 0;
}

size_t EventWindower::AddBatch(absl::Span<const Event> events) {
  YieldPoint();
  events = events.first(std::min(events.size(), kBatch));
  std::array<uint8_t, kBatch> marks;
  MarkHashSample(stream_index_, sample_masks_, absl::MakeSpan(marks).first(events.size()));
  const size_t count = AddSampled(events, marks);
  stream_index_ += count;
  count_ += count;
  while (num_kept_ > static_cast<size_t>(options_.max_events)) HalveSample();
  return count;
}

size_t EventWindower::AddSampled(absl::Span<const Event> events, absl::Span<const uint8_t> marks) {
  // Each event is written, and only the write position depends on whether it is kept: no branch. Members are copied to
  // local variables, because the compiler must assume that writing bytes of the history changes members.
  const int64_t begin_us = begin_us_;
  const int64_t boundary_us = boundary_us_;
  const uint64_t stream_index = stream_index_;
  WindowEvent* const kept = kept_.data();
  uint64_t* const indices = indices_.data();
  PixelHistory::Writer history(history_);
  int64_t now_us = now_us_;
  size_t num_kept = num_kept_;
  size_t count = 0;
  for (; count < events.size() && events[count].t_us < boundary_us; ++count) {
    const Event& event = events[count];
    PrefetchBeyond(event, kBatch);
    now_us = std::max(now_us, event.t_us);
    WindowEvent& next = kept[num_kept];
    next.t_us = std::max(event.t_us, begin_us);
    next.x = event.x;
    next.y = event.y;
    next.polarity = event.polarity;
    next.previous = history.Exchange(event);
    indices[num_kept] = stream_index + count;
    num_kept += marks[count] >> PolarityOf(event) & 1;
  }
  now_us_ = now_us;
  num_kept_ = num_kept;
  return count;
}

// The polarity is chosen from the first max_events + 1 kept events. The result therefore does not depend on the
// division of the stream into batches.
void EventWindower::HalveSample() {
  const auto first_too_many = kept_.begin() + options_.max_events + 1;
  const auto num_on = std::count_if(kept_.begin(), first_too_many, PolarityOf);
  uint64_t& mask = sample_masks_[2 * num_on > options_.max_events + 1 ? 1 : 0];
  mask = (mask << 1) | 1;
  std::array<uint8_t, kBatch> marks;
  size_t write = 0;
  for (size_t begin = 0; begin < num_kept_; begin += kBatch) {
    const auto numbers = absl::MakeConstSpan(indices_).subspan(begin, std::min(kBatch, num_kept_ - begin));
    MarkHashSample(numbers, sample_masks_, absl::MakeSpan(marks));
    for (size_t i = 0; i < numbers.size(); ++i) {
      const unsigned stays = marks[i] >> PolarityOf(kept_[begin + i]) & 1;
      kept_[write] = kept_[begin + i];
      indices_[write] = numbers[i];
      write += stays;
    }
  }
  num_kept_ = write;
}

void EventWindower::VisitState(auto& archive, auto& self) {
  auto& [options, interval_us, started, now_us, begin_us, boundary_us, stream_index, count, sample_masks, history, kept,
         indices, num_kept] = self;
  constexpr int64_t kMaxUs = kMaxStateTimeUs;
  archive(InRange(interval_us, options.min_interval_us, options.interval_us), started,
          InRange(begin_us, -kMaxUs, kMaxUs), InRange(now_us, -kMaxUs, kMaxUs), InRange(boundary_us, -kMaxUs, kMaxUs),
          stream_index, count, sample_masks[0], sample_masks[1], history);
  if (started) {
    // Finish() leaves the time just before the next window.
    archive.Check(now_us >= begin_us - 1 && now_us < boundary_us, "the time lies outside the open window");
    archive.Check(boundary_us > begin_us && boundary_us - begin_us <= options.max_duration_us,
                  "the open window is longer than max_duration_us");
  }
  archive.Check(count <= stream_index && (started || count == 0), "the open window has more events than the stream");
  for (const uint64_t mask : sample_masks) {
    archive.Check((mask & (mask + 1)) == 0, "the sampling mask of a window is not of the form 2^k - 1");
  }
}

void EventWindower::SaveState(StateWriter& writer) const {
  VisitState(writer, *this);
  SaveWindowEvents(writer, begin_us_, absl::MakeConstSpan(kept_).first(num_kept_));
  SaveIndices(writer);
}

void EventWindower::LoadState(StateReader& reader) {
  VisitState(reader, *this);
  std::vector<WindowEvent> kept;
  LoadWindowEvents(reader, begin_us_, boundary_us_, static_cast<size_t>(options_.max_events), kept);
  std::copy(kept.begin(), kept.end(), kept_.begin());
  num_kept_ = kept.size();
  LoadIndices(reader);
}

void EventWindower::SaveIndices(StateWriter& writer) const {
  if (!is_sampled()) return;  // all events of the window are kept: their numbers are consecutive
  uint64_t next = stream_index_ - count_;
  for (const uint64_t index : absl::MakeConstSpan(indices_).first(num_kept_)) {
    writer.Varint(index - next);
    next = index + 1;
  }
}

void EventWindower::LoadIndices(StateReader& reader) {
  reader.Check(is_sampled() ? num_kept_ <= count_ : num_kept_ == count_,
               "the number of kept events contradicts the number of events in the window");
  uint64_t next = stream_index_ - count_;
  for (size_t i = 0; i < num_kept_ && reader.ok(); ++i) {
    uint64_t skipped = 0;
    if (is_sampled()) reader.Varint(skipped);
    // The numbers must increase and be in the sample; otherwise HalveSample() might be repeated without end.
    reader.Check(skipped < stream_index_ - next, "the number of a kept event lies outside its window");
    reader.Check(IsInHashSample(next + skipped, sample_masks_[PolarityOf(kept_[i])]),
                 "a kept event is not in the window's sample");
    indices_[i] = next + skipped;
    next += skipped + 1;
  }
}

}  // namespace evpose
