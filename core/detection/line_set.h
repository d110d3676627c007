// From candidates to the lines of one stretch: each event to one line, one line for each edge, corners where they meet.
#pragma once

#include <vector>

#include "absl/status/status.h"
#include "core/detection/event_stretch.h"
#include "core/detection/moving_line.h"

namespace evpose {

struct LineSetOptions {
  LineFitOptions fit;
  // Fewer events, or a shorter line, are no line: chance makes them.
  int min_events = 30;
  double min_length_px = 12.0;
  // Pixels: an edge sends at least this many events for each pixel of its length, however it moves.
  double min_events_per_px = 0.5;
  // Pixels: the two sides of a thin stripe, and pieces of one edge, lie this close to one another; they become one
  // line.
  double merge_px = 2.5;
  // Pixels: how far an end may be from the crossing with another line to be taken as the corner there.
  double corner_px = 6.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// `candidates` by falling importance. By falling number of events.
std::vector<MovingLine> SelectLines(const EventStretch& stretch, const std::vector<MovingLine>& candidates,
                                    const LineSetOptions& options);

}  // namespace evpose
