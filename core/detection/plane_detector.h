// SPDX-License-Identifier: Apache-2.0

// Lines as planes in space and time (core/detection/README.md, section 1; Liu et al., IEEE TIP 2024, Sec. III-A).
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "core/detection/event_stretch.h"
#include "core/detection/line_detector.h"
#include "core/detection/line_set.h"
#include "core/detection/plane_segmentation.h"
#include "core/events/event.h"

namespace evpose {

struct PlaneDetectorOptions {
  StretchOptions stretch;
  PlaneSegmentationOptions segmentation;
  LineSetOptions lines;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// The paper finds the planes and takes their intersections with t = begin and t = end. Here the planes are where a
// robust fit to all events begins, which follows an edge's turning as well, gives each event to one line, ends lines
// where their events end or where two lines meet, and joins the pieces of an edge and the two sides of a stripe.
// Errors: INVALID_ARGUMENT.
absl::StatusOr<std::unique_ptr<LineDetector>> MakePlaneLineDetector(const PlaneDetectorOptions& options,
                                                                    SensorGeometry geometry);

}  // namespace evpose
