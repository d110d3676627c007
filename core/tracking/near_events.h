// The events of a window that may be of the lines, as the estimators see them (method.md 2.5).
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/base/thin.h"
#include "core/geometry/camera.h"
#include "core/tracking/association.h"
#include "core/tracking/background.h"
#include "core/windows/event_window.h"

namespace evpose {

// Used again for every window: what it allocates, it keeps.
class NearEvents {
 public:
  // `undistortion` and `pixel_tiles`, which are the camera's, must outlive it.
  NearEvents(const CameraModel& camera, const UndistortionTable& undistortion, const PixelTiles& pixel_tiles)
      : camera_(camera), undistortion_(undistortion), pixel_tiles_(pixel_tiles) {}

  // The window's events in tiles of `grid` with lines; those elsewhere are counted as background. At most `max_events`
  // of them are kept, evenly drawn. Returns how many of those found each one kept stands for, 1 or more.
  double Find(const EventWindow& window, const TileGrid& grid, int max_events, BackgroundRate& background);

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

 private:
  struct NearEvent {
    uint32_t index;  // into the window's events
    uint32_t tile;
  };

  const CameraModel camera_;
  const UndistortionTable& undistortion_;
  const PixelTiles& pixel_tiles_;
  std::vector<NearEvent> events_;
  std::vector<Observation> observations_;
};

}  // namespace evpose
