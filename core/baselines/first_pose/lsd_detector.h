// SPDX-License-Identifier: Apache-2.0

// Detection of lines by LSD in an image of accumulated events: the usual method, with which the paper compares its own
// (Liu et al., IEEE TIP 2024, Fig. 8).
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "core/detection/event_stretch.h"
#include "core/detection/line_detector.h"
#include "core/events/event.h"

namespace evpose {

// The defaults are validated by lsd_detector_test (the motion of an edge) and simulated_lines_test (more than half of
// the visible length is found), and by `evpose bench initialization --from-events --detector lsd`
// (core/experiments/RESULTS.md, The first pose).
struct LsdDetectorOptions {
  // Shorter than for planes, because the image of events is sharp only if the edges have moved little.
  StretchOptions stretch = {.motion_px = 3.0};
  // Number of events at which a pixel is white; further events have no effect. An edge that passes a pixel causes one
  // or two.
  int white_events = 2;
  // Standard deviation of the blur before LSD, pixels: events are scattered, and LSD needs gradients.
  double blur_px = 1.0;
  // Minimum length of a segment, pixels: LSD finds shorter ones in any scattered events.
  double min_length_px = 12.0;
  // Minimum number of events from which the motion of a segment is estimated; segments with fewer are dropped.
  int min_events = 30;
  // Maximum distance of an event from the moving segment in the fit of its motion, pixels.
  double gate_px = 2.0;
  // Distance, pixels, up to which two parallel segments are the two sides of one streak; the longer one is kept.
  double duplicate_px = 2.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Grompone von Gioi, Jakubowicz, Morel, Randall, "LSD: a Line Segment Detector", IPOL 2012, in OpenCV's implementation.
// LSD determines the direction and the end points; a robust fit of the distances of the events against time determines
// the lateral position and the speed, without a rotation. Errors: INVALID_ARGUMENT.
absl::StatusOr<std::unique_ptr<LineDetector>> MakeLsdLineDetector(const LsdDetectorOptions& options,
                                                                  SensorGeometry geometry);

}  // namespace evpose
