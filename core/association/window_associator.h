// SPDX-License-Identifier: Apache-2.0

// Association of a whole window: the events that may belong to the lines predicted for its middle
// (core/association/README.md).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/association/background.h"
#include "core/association/camera_tables.h"
#include "core/association/line_cells.h"
#include "core/association/line_events.h"
#include "core/association/near_events.h"
#include "core/geometry/camera.h"
#include "core/windows/event_window.h"

namespace evpose {

// A window's events near the predicted lines. Valid until the next call of the associator that returned it.
struct AssociatedEvents {
  absl::Span<const Observation> events;
  const LineEvents* sorted = nullptr;  // the same events by line; never null in the input of an estimator
  EventSampling sampling;              // sampling ratios and weights of the polarities
  double duration_s = 0.0;             // duration of the window
  double background_per_px2 = 0.0;     // expected background events per square pixel in this time
  absl::Span<const LineCell> cells;    // cells of the lines; empty: no line is near another
};

// Reuses its memory from window to window. Learns the background rate and the usual ratio of the polarities, so that
// windows must come in order.
class WindowAssociator {
 public:
  // `tables` are those of `camera` and must outlive the associator. `windows_per_ms`: see NearEvents.
  WindowAssociator(const CameraModel& camera, const CameraTables& tables, int64_t windows_per_ms = 1)
      : camera_(camera), grid_(camera), background_(camera), near_events_(camera, tables, windows_per_ms) {}

  // Returns the events of `window` within reach_px of a line at their own times, at most `max_events` of them.
  // `lines` are the image lines at `t_us`, the middle of the window. `others_per_px(observation)` returns
  // Observation::others_per_px.
  template <typename OthersPerPx>
  AssociatedEvents Associate(const EventWindow& window, absl::Span<const ImageLine> lines, int64_t t_us,
                             double reach_px, int max_events, const OthersPerPx& others_per_px) {
    AssociatedEvents associated;
    associated.duration_s = static_cast<double>(window.t_end_us - window.t_begin_us) * 1e-6;
    BuildGrid(lines, reach_px, associated.duration_s);
    associated.sampling = near_events_.Find(window, grid_, max_events, background_);
    background_.CloseWindow(grid_, associated.duration_s);
    associated.background_per_px2 = background_.hz_per_px() * associated.duration_s;
    associated.events = near_events_.Observe(window, grid_, lines, t_us, reach_px, others_per_px);
    line_events_.Sort(associated.events, lines.size(), lines);
    associated.sorted = &line_events_;
    FindCells(grid_, lines, cells_);
    associated.cells = cells_;
    return associated;
  }

  // Removes the lines of the last window; learned quantities are kept.
  void ClearLines() { grid_.Build({}, 0.0); }

  // The tiles with the lines of the last window.
  const TileGrid& grid() const { return grid_; }

  // Parts of the state that later windows depend on.
  BackgroundRate& background() { return background_; }
  const BackgroundRate& background() const { return background_; }
  NearEvents& near_events() { return near_events_; }
  const NearEvents& near_events() const { return near_events_; }

 private:
  // Enters the lines with the reach that their motion within the window needs.
  void BuildGrid(absl::Span<const ImageLine> lines, double reach_px, double duration_s) {
    // No gate is wider than this in practice; the bound limits the work.
    constexpr double kMaxReachPx = 128.0;
    double motion_px = 0.0;
    for (const ImageLine& line : lines) {
      if (!line.in_view()) continue;
      const double speed = std::abs(NormalSpeedPxPerS(camera_, line, 0.5));
      motion_px = std::max(motion_px, 0.5 * speed * duration_s);
    }
    grid_.Build(lines, std::min(reach_px + motion_px, kMaxReachPx));
  }

  const CameraModel camera_;
  TileGrid grid_;
  BackgroundRate background_;
  NearEvents near_events_;
  LineEvents line_events_;
  std::vector<LineCell> cells_;
};

}  // namespace evpose
