#include "core/tracking/near_events.h"

namespace evpose {

double NearEvents::Find(const EventWindow& window, const TileGrid& grid, int max_events, BackgroundRate& background) {
  events_.clear();
  for (size_t i = 0; i < window.events.size(); ++i) {
    if (i + kPrefetchAhead < window.events.size()) {
      const WindowEvent& ahead = window.events[i + kPrefetchAhead];
      pixel_tiles_.Prefetch(ahead.x, ahead.y);
    }
    const WindowEvent& event = window.events[i];
    if (event.x >= camera_.width_px || event.y >= camera_.height_px) continue;
    const uint32_t tile = pixel_tiles_.At(event.x, event.y);
    if (tile == TileGrid::kNoTile) continue;
    if (grid.has_lines(tile)) {
      events_.push_back({static_cast<uint32_t>(i), tile});
    } else {
      background.Count(tile);
    }
  }
  const size_t found = events_.size();
  ThinEvenly(static_cast<size_t>(max_events), events_);
  return events_.empty() ? 1.0 : static_cast<double>(found) / static_cast<double>(events_.size());
}

}  // namespace evpose
