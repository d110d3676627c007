// SPDX-License-Identifier: Apache-2.0

// Turns candidates into the lines of a stretch: assigns each event to one line, merges the pieces of an edge, and moves
// the ends of lines to the corners in which they meet.
#pragma once

#include <vector>

#include "absl/status/status.h"
#include "core/detection/event_stretch.h"
#include "core/detection/moving_line.h"

namespace evpose {

struct LineSetOptions {
  MovingLineOptions fit;
  // Minimum number of events and minimum length, pixels, of a line. Chance produces smaller ones. All values of this
  // struct are validated by simulated_lines_test and driving_lines_test.
  int min_events = 30;
  double min_length_px = 20.0;
  // Maximum root mean square distance of the events from the line, pixels. Clutter that fills the gate of 3 px evenly
  // has 1.73 px, the events of one edge have 0.4 to 1.2 px.
  double max_rms_px = 1.3;
  // Minimum number of events per pixel of the line's length. A moving edge produces more than this.
  double min_events_per_px = 0.5;
  // A candidate is a duplicate if more than this share of its events already belongs to lines: the greater part of its
  // events then supports other lines.
  double max_owned_ratio = 0.5;
  // Maximum distance of two lines, pixels, for a merge: pieces of one edge lie closer to a common line.
  double merge_px = 2.0;
  // Maximum distance, pixels, of two parallel edges of opposite polarity that move together, to be merged as the two
  // sides of a stripe. The resulting line lies between them (core/estimation/README.md, section 3).
  double stripe_px = 4.0;
  // Maximum distance, pixels, between the end of a line and its crossing with another line, for the end to be moved
  // there. Near a corner the gates of both lines (gate_px) overlap, so that the ends found from events are inexact;
  // with a larger limit ends move to crossings that are no corners.
  double corner_px = 6.0;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Returns the lines in descending order of the number of events. `candidates` must be in descending order of
// importance: events are assigned to earlier ones first. `options` must be valid.
std::vector<DetectedLine> SelectLines(const EventStretch& stretch, const std::vector<MovingLine>& candidates,
                                      const LineSetOptions& options);

}  // namespace evpose
