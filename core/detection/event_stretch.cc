// SPDX-License-Identifier: Apache-2.0
#include "core/detection/event_stretch.h"

#include <algorithm>
#include <cmath>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/numerics/sampling.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// The speed of an edge is measured in a patch of 7 x 7 pixels about an event: the edge has swept kSweptPx pixels of the
// patch (about two rows of seven) when kSweptPixels of its pixels have produced events.
constexpr int kPatchRadius = 3;
constexpr int kSweptPixels = 16;
constexpr double kSweptPx = 2.0;
// Number of events at which the speed is measured; more do not change the median.
constexpr size_t kMaxSpeedSamples = 600;
// Number of latest events that the measurement reads: several passages of several edges.
constexpr size_t kMaxSpeedEvents = LastTimes::kMaxKeys;

// Events beyond this multiple of max_events are removed by uniform downsampling before any other step, which bounds the
// work.
constexpr size_t kMaxInputRatio = 8;
// An event is isolated if its cell of space and time, with this side in pixels, has fewer than kMinCellEvents events.
// The cells share the slots of a hash table; a collision keeps a few isolated events.
constexpr double kIsolationCellPx = 3.0;
constexpr uint8_t kMinCellEvents = 3;
constexpr size_t kCellSlots = 1u << 20;   // 1 MB, several times the number of occupied cells
constexpr double kMinSpeedPxPerS = 1e-3;  // avoids a division by zero; the duration is limited anyway

// The key of a pixel of the map and the polarity of an event in LastTimes.
uint32_t KeyOf(const PixelEvent& event, int pixel) {
  return 2 * static_cast<uint32_t>(pixel) + (event.polarity != 0 ? 1 : 0);
}

absl::Span<const PixelEvent> From(int64_t t_us, absl::Span<const PixelEvent> events) {
  const auto first = std::lower_bound(events.begin(), events.end(), t_us,
                                      [](const PixelEvent& event, int64_t t) { return event.t_us < t; });
  return events.subspan(first - events.begin());
}

}  // namespace

absl::Status StretchOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("motion_px", motion_px, 1.0, 100.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_duration_us", static_cast<double>(max_duration_us), 100, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_slow_duration_us", static_cast<double>(max_slow_duration_us),
                                    static_cast<double>(max_duration_us), 10'000'000));
  return CheckRange("max_events", max_events, 100, 1'000'000);
}

StretchSelector::StretchSelector(const StretchOptions& options, int width_px, int height_px)
    : options_(options),
      margin_x_(width_px / 4 + kPatchRadius),
      margin_y_(height_px / 4 + kPatchRadius),
      map_width_(width_px + 2 * margin_x_),
      map_height_(height_px + 2 * margin_y_) {}

uint16_t StretchSelector::Ticks(const PixelEvent& event, int64_t t_origin_us) const {
  return static_cast<uint16_t>(std::clamp<int64_t>((event.t_us - t_origin_us) / tick_us_, 0, LastTimes::kNever - 1));
}

int StretchSelector::PixelIndex(const PixelEvent& event) const {
  // The comparison precedes the conversion, because the conversion of a float out of range is undefined.
  const float x = event.u_px + static_cast<float>(margin_x_) + 0.5f;
  const float y = event.v_px + static_cast<float>(margin_y_) + 0.5f;
  const bool inside = x >= kPatchRadius && y >= kPatchRadius && x < static_cast<float>(map_width_ - kPatchRadius) &&
                      y < static_cast<float>(map_height_ - kPatchRadius);
  return inside ? static_cast<int>(y) * map_width_ + static_cast<int>(x) : -1;
}

double StretchSelector::SweepTime(const PixelEvent& event, int pixel, int64_t t_origin_us) {
  const uint16_t now = Ticks(event, t_origin_us);
  ages_.clear();
  for (int dy = -kPatchRadius; dy <= kPatchRadius; ++dy) {
    for (int dx = -kPatchRadius; dx <= kPatchRadius; ++dx) {
      const uint16_t last = last_.Get(KeyOf(event, pixel + dy * map_width_ + dx));
      if (last <= now) ages_.push_back(static_cast<uint16_t>(now - last));
    }
  }
  if (ages_.size() <= static_cast<size_t>(kSweptPixels)) return -1.0;
  return static_cast<double>(tick_us_ * SelectNth(ages_, kSweptPixels));
}

double StretchSelector::MedianSpeed(absl::Span<const PixelEvent> events) {
  if (events.size() > kMaxSpeedEvents) events.remove_prefix(events.size() - kMaxSpeedEvents);
  const int64_t t_origin_us = events.front().t_us;
  tick_us_ = 1 + (events.back().t_us - t_origin_us) / LastTimes::kNever;
  last_.Clear();
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    const int pixel = PixelIndex(events[k]);
    if (pixel >= 0) last_.Set(KeyOf(events[k], pixel), Ticks(events[k], t_origin_us));
  }
  std::vector<double> times_us;
  const size_t stride = std::max<size_t>(1, events.size() / kMaxSpeedSamples);
  for (size_t i = events.size() % stride; i < events.size(); i += stride) {
    YieldPoint(times_us.size());
    const int pixel = PixelIndex(events[i]);
    if (pixel < 0) continue;
    const double time_us = SweepTime(events[i], pixel, t_origin_us);
    if (time_us >= 0.0) times_us.push_back(std::max(time_us, 1.0));
  }
  if (times_us.empty()) return 0.0;
  return kSweptPx * 1e6 / UpperMedian(times_us);
}

void StretchSelector::RemoveIsolated(std::vector<StretchEvent>& events, double px_per_s) {
  cell_counts_.assign(kCellSlots, 0);
  const auto slot = [px_per_s](const StretchEvent& event) {
    uint64_t key = event.polarity;
    for (const double coordinate :
         {static_cast<double>(event.u_px), static_cast<double>(event.v_px), px_per_s * event.tau_s}) {
      key = (key ^ static_cast<uint64_t>(static_cast<int64_t>(std::floor(coordinate / kIsolationCellPx)))) *
            0x9e3779b97f4a7c15u;
      key ^= key >> 29;
    }
    return static_cast<size_t>(key % kCellSlots);
  };
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    uint8_t& count = cell_counts_[slot(events[k])];
    if (count < kMinCellEvents) ++count;
  }
  std::erase_if(events, [&, k = size_t{0}](const StretchEvent& event) mutable {
    YieldPoint(k++);
    return cell_counts_[slot(event)] < kMinCellEvents;
  });
}

absl::Span<const PixelEvent> StretchSelector::SelectSpan(absl::Span<const PixelEvent> events, double& speed_px_per_s) {
  absl::Span<const PixelEvent> usable;
  for (const int64_t duration_us : {options_.max_duration_us, options_.max_slow_duration_us}) {
    usable = From(events.back().t_us - duration_us, events);
    // With fewer events than this, flicker cannot displace the events of edges.
    if (usable.size() > 2 * static_cast<size_t>(options_.max_events)) usable = flicker_.Remove(usable);
    YieldPoint();
    speed_px_per_s = MedianSpeed(usable);
    if (1e-6 * static_cast<double>(duration_us) * speed_px_per_s >= options_.motion_px) break;
  }
  return usable;
}

EventStretch StretchSelector::Select(absl::Span<const PixelEvent> events) {
  EventStretch stretch;
  if (events.empty()) return stretch;
  stretch.t_end_us = events.back().t_us;
  const absl::Span<const PixelEvent> usable = SelectSpan(events, stretch.speed_px_per_s);
  const double duration_us = options_.motion_px * 1e6 / std::max(stretch.speed_px_per_s, kMinSpeedPxPerS);
  stretch.t_begin_us =
      std::max(usable.front().t_us, stretch.t_end_us - static_cast<int64_t>(std::min(duration_us, 1e9)));
  stretch.time_scale_px_per_s =
      options_.motion_px * 1e6 / static_cast<double>(std::max<int64_t>(1, stretch.t_end_us - stretch.t_begin_us));
  YieldPoint();
  const absl::Span<const PixelEvent> taken = From(stretch.t_begin_us, usable);
  SelectionSampler bounded(taken.size(), kMaxInputRatio * static_cast<size_t>(options_.max_events));
  for (size_t k = 0; k < taken.size(); ++k) {
    YieldPoint(k);
    const PixelEvent& event = taken[k];
    if (!bounded.TakesNext() || PixelIndex(event) < 0) continue;
    stretch.events.push_back(
        {event.u_px, event.v_px,
         static_cast<float>(1e-6 * static_cast<double>(event.t_us - stretch.t_begin_us) - stretch.half_duration_s()),
         static_cast<uint8_t>(event.polarity != 0)});
  }
  if (stretch.events.size() > static_cast<size_t>(options_.max_events)) {
    // Isolated events are removed only far above the limit, because faint and slow edges also cause isolated events.
    if (stretch.events.size() > 2 * static_cast<size_t>(options_.max_events)) {
      YieldPoint();
      RemoveIsolated(stretch.events, stretch.time_scale_px_per_s);
    }
    SelectionSampler sample(stretch.events.size(), options_.max_events);
    std::erase_if(stretch.events, [&sample](const StretchEvent&) { return !sample.TakesNext(); });
  }
  return stretch;
}

}  // namespace evpose
