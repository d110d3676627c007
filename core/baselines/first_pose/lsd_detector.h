// SPDX-License-Identifier: Apache-2.0

// Lines by LSD on the image of accumulated events, the usual way and the comparison in the paper (Liu et al., IEEE TIP
// 2024, its Fig. 8).
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "core/detection/event_stretch.h"
#include "core/detection/line_detector.h"
#include "core/events/event.h"

namespace evpose {

struct LsdDetectorOptions {
  // Shorter than for planes: an image of events is sharp only while edges move by little.
  StretchOptions stretch = {.motion_px = 3.0};
  // Events at a pixel that make it white; more do not count. One or two is what a pass of an edge sends.
  int white_events = 2;
  // Pixels: standard deviation of the blur before LSD. Events are scattered; LSD wants gradients.
  double blur_px = 1.0;
  // Pixels: shorter segments are dropped: LSD finds them in any scatter.
  double min_length_px = 12.0;
  // Events on a segment that its motion is told from; those with fewer are dropped.
  int min_events = 30;
  // Pixels: farthest event of a segment, when the motion is fitted.
  double gate_px = 2.0;
  // Pixels: segments this close that lie side by side are the two sides of one streak; the longer stays.
  double duplicate_px = 2.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Grompone von Gioi, Jakubowicz, Morel, Randall, "LSD: a Line Segment Detector", IPOL 2012, as OpenCV has it. Position
// across and speed follow from a robust fit of the events' distances against time (without turning); direction and end
// points are LSD's. Errors: INVALID_ARGUMENT.
absl::StatusOr<std::unique_ptr<LineDetector>> MakeLsdLineDetector(const LsdDetectorOptions& options,
                                                                  SensorGeometry geometry);

}  // namespace evpose
