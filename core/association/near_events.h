// SPDX-License-Identifier: Apache-2.0

// The events of a window that may be of the lines, as the estimators see them (core/association/README.md, section 2).
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/association/background.h"
#include "core/geometry/camera.h"
#include "core/numerics/sampling.h"
#include "core/windows/event_window.h"

namespace evpose {

// How many events of a window each one kept stands for.
struct NearShares {
  ByPolarity events_per_observation = {1.0, 1.0};
  double mean_events_per_observation = 1.0;        // of those kept
  ByPolarity telling = {1.0, 1.0};                 // less while a lamp's change floods the image with this polarity
  double observations_per_background_event = 1.0;  // of those elsewhere, had they been thinned like those that are near
};

// Used again for every window: what it allocates, it keeps.
class NearEvents {
 public:
  // `undistortion` and `pixel_tiles`, which are the camera's, must outlive it.
  NearEvents(const CameraModel& camera, const UndistortionTable& undistortion, const PixelTiles& pixel_tiles)
      : camera_(camera), undistortion_(undistortion), pixel_tiles_(pixel_tiles) {}

  // The window's events in tiles of `grid` with lines; those elsewhere are counted as background. At most `max_events`
  // of them are kept, evenly drawn of each polarity, and of both as is usual: while a lamp grows brighter or darker, a
  // flood of one polarity comes from everywhere, and the few events of the other are the edges'.
  NearShares Find(const EventWindow& window, const TileGrid& grid, int max_events, BackgroundRate& background);

  // Of those that Find() kept of the same window and grid the ones within reach_px of a line at their own times, as
  // observations at `t_us`. `lines`: those of the grid. `competing` is asked for Observation::competing. Valid until
  // the next call.
  template <typename Competing>
  absl::Span<const Observation> Observe(const EventWindow& window, const TileGrid& grid,
                                        absl::Span<const ImageLine> lines, int64_t t_us, double reach_px,
                                        const Competing& competing) {
    observations_.clear();
    for (size_t i = 0; i < events_.size(); ++i) {
      if (i + kPrefetchAhead < events_.size()) {
        const WindowEvent& ahead = window.events[events_[i + kPrefetchAhead].index];
        undistortion_.Prefetch(ahead.x, ahead.y);
      }
      const NearEvent& near = events_[i];
      std::optional<Observation> observation = evpose::Observe(camera_, undistortion_, window.events[near.index], t_us);
      if (!observation) continue;  // found on the sensor
      grid.GiveLines(near.tile, *observation);
      observation->competing = competing(*observation);
      KeepLinesWithin(reach_px, lines.data(), *observation);
      if (observation->num_lines > 0) observations_.push_back(*observation);
    }
    return observations_;
  }

  static void VisitState(auto& archive, auto& self) {
    auto& [camera, undistortion, pixel_tiles, events, observations, usual_events] = self;
    constexpr double kMax = 1e18;
    archive(InRange(usual_events[0], kFewEvents, kMax), InRange(usual_events[1], kFewEvents, kMax));
  }

 private:
  static constexpr double kFewEvents = 1.0;  // ratio of so many events is none
  struct NearEvent {
    uint32_t index;  // into the window's events
    uint32_t tile : 31;
    uint32_t polarity : 1;
  };
  void LearnUsual(const ByPolarity& near_events);
  // By polarity, of what is to be kept of those found.
  ByPolarity WantedShares(const ByPolarity& found) const;
  // By how much more than the usual share of both there is of each polarity; one of them, at least, 1.
  ByPolarity Excess(const ByPolarity& found) const;

  const CameraModel camera_;
  const UndistortionTable& undistortion_;
  const PixelTiles& pixel_tiles_;
  std::vector<NearEvent> events_;
  std::vector<Observation> observations_;
  ByPolarity usual_events_ = {kFewEvents, kFewEvents};  // of the last windows
};

}  // namespace evpose
