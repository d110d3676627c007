// SPDX-License-Identifier: Apache-2.0

// From candidates to the lines of one stretch: each event to one line, one line for each edge, corners where they meet.
#pragma once

#include <vector>

#include "absl/status/status.h"
#include "core/detection/event_stretch.h"
#include "core/detection/moving_line.h"

namespace evpose {

struct LineSetOptions {
  MovingLineOptions fit;
  // Fewer events, or a shorter line, are no line: chance makes them.
  int min_events = 30;
  double min_length_px = 20.0;
  // Pixels: events that fill the gate evenly (1.73 of 3) are clutter; those of one edge have 0.4 to 1.2.
  double max_rms_px = 1.3;
  // Pixels: an edge sends at least this many events for each pixel of its length, however it moves.
  double min_events_per_px = 0.5;
  // Pixels: pieces of one edge lie this close to one line, and become one.
  double merge_px = 2.0;
  // Pixels: two edges of opposite polarity that lie side by side and move together, no farther apart than this, are the
  // sides of a stripe; the line is between them (core/estimation/README.md, section 3).
  double stripe_px = 4.0;
  // Pixels: how far an end may be from the crossing with another line to be taken as the corner there.
  double corner_px = 6.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// `candidates` by falling importance. By falling number of events.
std::vector<DetectedLine> SelectLines(const EventStretch& stretch, const std::vector<MovingLine>& candidates,
                                      const LineSetOptions& options);

}  // namespace evpose
