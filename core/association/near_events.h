// SPDX-License-Identifier: Apache-2.0

// Selects the events of a window that lie near the lines, downsamples them and converts them to observations
// (core/association/README.md, section 4).
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/association/background.h"
#include "core/association/camera_tables.h"
#include "core/base/yield_point.h"
#include "core/geometry/camera.h"
#include "core/numerics/sampling.h"
#include "core/windows/event_window.h"

namespace evpose {

// The ratios between events of the sensor and observations, and the weights of the polarities.
struct EventSampling {
  ByPolarity events_per_observation = {1.0, 1.0};  // number of events that each observation represents
  double mean_events_per_observation = 1.0;        // the same over both polarities
  // Weight of each polarity in tests of the events: below 1 while a flicker burst produces events of this polarity in
  // the whole image.
  ByPolarity polarity_weight = {1.0, 1.0};
  ByPolarity near_events = {};  // events of the sensor in tiles with lines
  // Sampling ratio that the background events of the window would have if they were sampled like the events near lines.
  double observations_per_background_event = 1.0;
};

// Selects the events near the lines. One object is used for all windows of a track, because it keeps the usual event
// rates of both polarities, and its memory.
class NearEvents {
 public:
  // `tables` must be those of `camera` and outlive the object. `windows_per_ms` is
  // WindowOptions::intervals_per_usual().
  NearEvents(const CameraModel& camera, const CameraTables& tables, int64_t windows_per_ms)
      : camera_(camera), tables_(tables), keep_(1.0 - kForgetPerMs / static_cast<double>(windows_per_ms)) {}

  // Stores the events of the window that lie in tiles with lines, and counts the others in `background`. At most
  // `max_events` events are kept by uniform downsampling, in the usual ratio of the polarities. While the brightness of
  // a lamp changes, the whole image produces events of one polarity, and the few events of the other are due to edges.
  EventSampling Find(const EventWindow& window, const TileGrid& grid, int max_events, BackgroundRate& background);

  // Converts the events that Find() kept, for the same window and grid, to observations relative to time `t_us`, and
  // returns those within reach_px of a line at the time of the event. `lines` are the lines of the grid;
  // `others_per_px(observation)` returns Observation::others_per_px. The result is valid until the next call.
  template <typename OthersPerPx>
  absl::Span<const Observation> Observe(const EventWindow& window, const TileGrid& grid,
                                        absl::Span<const ImageLine> lines, int64_t t_us, double reach_px,
                                        const OthersPerPx& others_per_px) {
    observations_.clear();
    for (size_t i = 0; i < events_.size(); ++i) {
      YieldPoint(i);
      if (i + kPrefetchAhead < events_.size()) {
        const WindowEvent& ahead = window.events[events_[i + kPrefetchAhead].index];
        tables_.undistortion.Prefetch(ahead.x, ahead.y);
      }
      const NearEvent& near = events_[i];
      std::optional<Observation> observation =
          evpose::Observe(camera_, tables_.undistortion, window.events[near.index], t_us);
      if (!observation) continue;  // cannot happen: Find() keeps events inside the sensor only
      grid.GiveLines(near.tile, *observation);
      observation->others_per_px = others_per_px(*observation);
      KeepLinesWithin(reach_px, lines.data(), *observation);
      if (observation->num_lines > 0) observations_.push_back(*observation);
    }
    return observations_;
  }

  static void VisitState(auto& archive, auto& self) {
    auto& [camera, tables, keep, divided, events, observations, usual_events] = self;
    constexpr double kMax = 1e18;  // events; keeps sums and ratios finite
    archive(InRange(usual_events[0], kFewEvents, kMax), InRange(usual_events[1], kFewEvents, kMax));
  }

 private:
  static constexpr double kFewEvents = 1.0;  // events; lower bound that keeps the ratio of the polarities finite
  // Decay of the usual events in 1 ms: a memory of 33 ms, three periods of the light of a lamp on 50 Hz mains, so that
  // both polarities are averaged.
  static constexpr double kForgetPerMs = 0.03;
  struct NearEvent {
    uint32_t index;  // into the window's events
    uint32_t tile : 31;
    uint32_t polarity : 1;
  };
  // The events of a window in tiles with lines, and those in other tiles, the last one first.
  struct Division {
    absl::Span<const NearEvent> near;
    absl::Span<const NearEvent> away_reversed;
  };
  // The result is valid until the next call.
  Division Divide(absl::Span<const WindowEvent> events, const TileGrid& grid);
  void UpdateUsualEvents(const ByPolarity& near_events);
  // Returns the shares of OFF and ON events in the sample; their sum is 1. `found`: number of events of each polarity.
  ByPolarity SampleShares(const ByPolarity& found) const;
  // Returns, for each polarity, the factor (at least 1) by which its ratio to the other polarity exceeds the usual
  // ratio. At most one of the two factors is above 1.
  ByPolarity Excess(const ByPolarity& found) const;

  const CameraModel camera_;
  const CameraTables& tables_;
  const double keep_;               // factor of the usual events per window
  std::vector<NearEvent> divided_;  // of Divide()
  std::vector<NearEvent> events_;   // the kept ones of those near lines
  std::vector<Observation> observations_;
  ByPolarity usual_events_ = {kFewEvents, kFewEvents};  // exponentially weighted sums over the past windows
};

}  // namespace evpose
