// SPDX-License-Identifier: Apache-2.0
#include "core/detection/flicker_filter.h"

#include <cstdint>

#include "core/base/yield_point.h"

namespace evpose {
namespace {

// Duration of a slice, microseconds: short compared with the 5 ms in which a lamp on 50 Hz mains rises or falls, and
// long enough for the events of a few edges.
constexpr int64_t kSliceUs = 500;
// Factor by which the ratio of the polarities varies in steady light; a smaller excess is no flicker.
constexpr double kSteadyExcess = 1.5;
// Number of events added to each count: a ratio of smaller numbers is not significant.
constexpr double kFewEvents = 10.0;

size_t SliceOf(const PixelEvent& event, int64_t t_begin_us) {
  return static_cast<size_t>((event.t_us - t_begin_us) / kSliceUs);
}

// Returns the number of kept events of a slice with `own` events of this polarity and `other` of the other one. `ratio`
// is the usual number of own events per other event.
size_t NumKept(size_t own, size_t other, double ratio) {
  const double expected = kSteadyExcess * ratio * (static_cast<double>(other) + kFewEvents);
  const double count = static_cast<double>(own);
  if (count <= expected) return own;
  // The square of the share of edge events: an edge event among flicker events also carries less information.
  return static_cast<size_t>(expected * expected / count);
}

}  // namespace

absl::Span<const PixelEvent> FlickerFilter::Remove(absl::Span<const PixelEvent> events) {
  kept_.clear();
  if (events.empty()) return kept_;
  const int64_t t_begin_us = events.front().t_us;
  slices_.assign(SliceOf(events.back(), t_begin_us) + 1, Counts{});
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    ++slices_[SliceOf(events[k], t_begin_us)][events[k].polarity != 0];
  }
  std::array<double, 2> total = {kFewEvents, kFewEvents};
  for (const Counts& slice : slices_) {
    for (int polarity = 0; polarity < 2; ++polarity) total[polarity] += static_cast<double>(slice[polarity]);
  }
  samples_.clear();
  for (const Counts& slice : slices_) {
    samples_.emplace_back(slice[0], NumKept(slice[0], slice[1], total[0] / total[1]));
    samples_.emplace_back(slice[1], NumKept(slice[1], slice[0], total[1] / total[0]));
  }
  for (size_t k = 0; k < events.size(); ++k) {
    YieldPoint(k);
    const PixelEvent& event = events[k];
    const size_t sample = 2 * SliceOf(event, t_begin_us) + (event.polarity != 0 ? 1 : 0);
    if (samples_[sample].TakesNext()) kept_.push_back(event);
  }
  return kept_;
}

}  // namespace evpose
