// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/motion_samples.h"

#include <algorithm>

#include "core/numerics/statistics.h"
#include "core/tracking/object/event_extent.h"

namespace evpose {
namespace {

// Keeps every second value.
void Halve(std::vector<double>& values) {
  for (size_t i = 0; 2 * i < values.size(); ++i) values[i] = values[2 * i];
  values.resize((values.size() + 1) / 2);
}

}  // namespace

MotionSamples::MotionSamples(SensorGeometry geometry)
    : geometry_(geometry), selector_(StretchOptions(), geometry.width_px, geometry.height_px) {
  latest_.reserve(2 * kMaxEvents);
}

void MotionSamples::Add(absl::Span<const Event> events) {
  for (const Event& event : events) {
    if (!has_event_) {
      has_event_ = true;
      last_us_ = event.t_us;
      next_sample_us_ = event.t_us + sample_period_us_;
      slice_end_us_ = event.t_us + kSliceUs;
    }
    // The selector requires the order of time. After a jump back, the samples continue from there.
    if (event.t_us < last_us_ - kSliceUs || event.t_us > last_us_ + 10 * kMemoryUs) {
      latest_.clear();
      next_sample_us_ = event.t_us + sample_period_us_;
      slice_end_us_ = event.t_us + kSliceUs;
      slice_events_ = 0.0;
      last_us_ = event.t_us;
    }
    last_us_ = std::max(last_us_, event.t_us);
    while (last_us_ >= slice_end_us_) CloseSlice();
    slice_events_ += 1.0;
    if (latest_.size() == 2 * kMaxEvents) latest_.erase(latest_.begin(), latest_.begin() + kMaxEvents);
    latest_.push_back({last_us_, static_cast<float>(event.x), static_cast<float>(event.y), event.polarity});
    if (last_us_ >= next_sample_us_) Sample();
  }
}

void MotionSamples::Sample() {
  next_sample_us_ = last_us_ + sample_period_us_;
  const auto begin = std::partition_point(
      latest_.begin(), latest_.end(), [this](const PixelEvent& event) { return event.t_us < last_us_ - kMemoryUs; });
  const size_t count = std::min<size_t>(static_cast<size_t>(latest_.end() - begin), kMaxEvents);
  const absl::Span<const PixelEvent> events(latest_.data() + (latest_.size() - count), count);
  speeds_px_per_s_.push_back(selector_.Select(events).speed_px_per_s);
  extents_px_.push_back(EventExtentPx(events, geometry_.width_px, geometry_.height_px));
  if (speeds_px_per_s_.size() < kMaxSamples) return;
  Halve(speeds_px_per_s_);
  Halve(extents_px_);
  sample_period_us_ *= 2;
}

void MotionSamples::CloseSlice() {
  if (slice_events_ > largest_) {
    largest_ = slice_events_;
    busiest_us_ = slice_end_us_ - kSliceUs;
  }
  if (num_slices_++ % slice_stride_ == 0) slices_.push_back(slice_events_);
  slice_events_ = 0.0;
  slice_end_us_ += kSliceUs;
  if (slices_.size() < kMaxSlices) return;
  Halve(slices_);
  slice_stride_ *= 2;
}

MotionSamples::Result MotionSamples::Measure() const {
  MotionSamples copy = *this;
  if (copy.speeds_px_per_s_.empty() && !copy.latest_.empty()) copy.Sample();
  if (copy.slices_.empty() && !copy.latest_.empty()) {
    const int64_t duration_us = std::max<int64_t>(1, kSliceUs - (slice_end_us_ - last_us_));
    copy.slices_.push_back(slice_events_ * kSliceUs / static_cast<double>(duration_us));
    copy.largest_ = copy.slices_.front();
    copy.busiest_us_ = slice_end_us_ - kSliceUs;
  }
  Result result;
  result.num_samples = static_cast<int>(copy.speeds_px_per_s_.size());
  result.speed_px_per_s = UpperMedianOr(copy.speeds_px_per_s_, 0.0);
  result.extent_px = UpperMedianOr(copy.extents_px_, 0.0);
  result.median_events_in_20_ms = UpperMedianOr(copy.slices_, 0.0);
  if (!copy.slices_.empty()) result.busy_events_in_20_ms = UpperQuantile(copy.slices_, 0.9);
  result.largest_events_in_20_ms = copy.largest_;
  result.busiest_us = copy.busiest_us_;
  return result;
}

}  // namespace evpose
