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

NearEvents::Division NearEvents::Divide(absl::Span<const WindowEvent> events, const TileGrid& grid) {
  // Each event is written to both ends, and one of the two positions advances: a branch on it could often not be
  // predicted. One place more than events keeps the two positions apart.
  if (divided_.size() <= events.size()) divided_.resize(2 * events.size() + 1);
  // Members are copied to local variables, because the compiler must assume that writing changes members.
  NearEvent* near = divided_.data();
  NearEvent* away = near + events.size();
  const TileTable& tiles = tables_.tiles;
  const int width_px = camera_.width_px, height_px = camera_.height_px;
  for (size_t i = 0; i < events.size(); ++i) {
    if (i + kPrefetchAhead < events.size()) {
      const WindowEvent& ahead = events[i + kPrefetchAhead];
      tiles.Prefetch(ahead.x, ahead.y);
    }
    const WindowEvent& event = events[i];
    if (event.x >= width_px || event.y >= height_px) continue;
    const uint32_t tile = tiles.TileOf(event.x, event.y);
    if (tile == TileGrid::kNoTile) continue;
    const bool is_near = grid.has_lines(tile);
    *near = *away = {static_cast<uint32_t>(i), tile, event.polarity};
    near += is_near ? 1 : 0;
    away -= is_near ? 0 : 1;
  }
  const absl::Span<const NearEvent> all = absl::MakeConstSpan(divided_).first(events.size() + 1);
  return {all.first(near - divided_.data()), all.subspan(away + 1 - divided_.data())};
}

EventSampling NearEvents::Find(const EventWindow& window, const TileGrid& grid, int max_events,
                               BackgroundRate& background) {
  const Division division = Divide(window.events, grid);
  ByPolarity background_events = {};
  for (size_t i = division.away_reversed.size(); i > 0; --i) {
    const NearEvent& event = division.away_reversed[i - 1];
    const double stands_for = window.events_per_sample[event.polarity];
    background_events[event.polarity] += stands_for;
    background.Count(event.tile, stands_for);
  }
  const auto is_on = [](const NearEvent& near) { return near.polarity; };
  const auto num_on = static_cast<double>(std::count_if(division.near.begin(), division.near.end(), is_on));
  const ByPolarity found = {static_cast<double>(division.near.size()) - num_on, num_on};
  const ByPolarity near_events = {found[0] * window.events_per_sample[0], found[1] * window.events_per_sample[1]};
  UpdateUsualEvents(near_events);
  // As many as the sample may have, so that no allocation follows when a later window has more events.
  events_.reserve(std::min(static_cast<size_t>(max_events), divided_.size()) + 1);
  const ByPolarity samples_per_observation =
      DownsampleByClass(static_cast<size_t>(max_events), SampleShares(found), division.near, is_on, events_);
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
