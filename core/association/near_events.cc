// SPDX-License-Identifier: Apache-2.0
#include "core/association/near_events.h"

#include <algorithm>

namespace evpose {
namespace {

// Excess of a polarity over the usual ratio above which it counts as a flicker burst. Its weight and its share of the
// sample then decrease with the excess. A lower limit also reduces the weight of events in windows whose ratio varies
// by the motion alone; a higher one keeps more events of the flicker.
constexpr double kFlickerExcess = 2.0;

double SumOf(const ByPolarity& both) { return both[0] + both[1]; }

// Returns the number of observations per event, given the events of each polarity and the events that each observation
// represents; 1 without events.
double ObservedRatio(const ByPolarity& events_per_observation, const ByPolarity& events) {
  if (SumOf(events) <= 0.0) return 1.0;
  return (events[0] / events_per_observation[0] + events[1] / events_per_observation[1]) / SumOf(events);
}

}  // namespace

EventSampling NearEvents::Find(const EventWindow& window, const TileGrid& grid, int max_events,
                               BackgroundRate& background) {
  events_.clear();
  ByPolarity background_events = {};
  // Members are copied to local variables, because the compiler must assume that Count() changes members.
  const absl::Span<const WindowEvent> events = window.events;
  const ByPolarity events_per_sample = window.events_per_sample;
  const CameraModel camera = camera_;
  for (size_t i = 0; i < events.size(); ++i) {
    if (i + kPrefetchAhead < events.size()) {
      const WindowEvent& ahead = events[i + kPrefetchAhead];
      undistortion_.Prefetch(ahead.x, ahead.y);
    }
    const WindowEvent& event = events[i];
    if (event.x >= camera.width_px || event.y >= camera.height_px) continue;
    const Eigen::Vector2f bearing = undistortion_.Bearing(event.x, event.y);
    const uint32_t tile =
        grid.TileOf(camera.fx_px * bearing.x() + camera.cx_px, camera.fy_px * bearing.y() + camera.cy_px);
    if (tile == TileGrid::kNoTile) continue;
    if (grid.has_lines(tile)) {
      events_.push_back({static_cast<uint32_t>(i), tile, event.polarity});
    } else {
      const double stands_for = events_per_sample[event.polarity];
      background_events[event.polarity] += stands_for;
      background.Count(tile, stands_for);
    }
  }
  const auto is_on = [](const NearEvent& near) { return near.polarity; };
  const auto num_on = static_cast<double>(std::count_if(events_.begin(), events_.end(), is_on));
  const ByPolarity found = {static_cast<double>(events_.size()) - num_on, num_on};
  const ByPolarity near_events = {found[0] * window.events_per_sample[0], found[1] * window.events_per_sample[1]};
  UpdateUsualEvents(near_events);
  const ByPolarity samples_per_observation = DownsampleByClass(static_cast<size_t>(max_events), SampleShares(found),
                                                               absl::MakeConstSpan(events_), is_on, events_);
  EventSampling sampling;
  sampling.near_events = near_events;
  for (int polarity = 0; polarity < 2; ++polarity) {
    sampling.events_per_observation[polarity] = window.events_per_sample[polarity] * samples_per_observation[polarity];
  }
  const ByPolarity excess = Excess(found);
  for (int polarity = 0; polarity < 2; ++polarity) {
    sampling.polarity_weight[polarity] = std::min(1.0, kFlickerExcess / excess[polarity]);
  }
  sampling.mean_events_per_observation = 1.0 / ObservedRatio(sampling.events_per_observation, near_events);
  // Without background events, the ratio of the polarities is assumed to be that of the events near lines.
  sampling.observations_per_background_event =
      ObservedRatio(sampling.events_per_observation, SumOf(background_events) > 0.0 ? background_events : near_events);
  return sampling;
}

void NearEvents::UpdateUsualEvents(const ByPolarity& near_events) {
  for (int polarity = 0; polarity < 2; ++polarity) {
    usual_events_[polarity] = std::max(kFewEvents, keep_ * usual_events_[polarity]) + near_events[polarity];
  }
}

ByPolarity NearEvents::Excess(const ByPolarity& found) const {
  const double on_excess = (found[1] + kFewEvents) / usual_events_[1] * usual_events_[0] / (found[0] + kFewEvents);
  return {std::max(1.0, 1.0 / on_excess), std::max(1.0, on_excess)};
}

ByPolarity NearEvents::SampleShares(const ByPolarity& found) const {
  const ByPolarity excess = Excess(found);
  ByPolarity share = usual_events_;
  for (int polarity = 0; polarity < 2; ++polarity) {
    share[polarity] *= std::max(1.0, std::min(excess[polarity], kFlickerExcess * kFlickerExcess / excess[polarity]));
  }
  const double all = SumOf(share);
  return {share[0] / all, share[1] / all};
}

}  // namespace evpose
