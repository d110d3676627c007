// SPDX-License-Identifier: Apache-2.0

// Lines as planes in space and time (core/detection/README.md, section 1; Liu et al., IEEE TIP 2024, Sec. III-A).
#pragma once

#include <memory>
#include <vector>

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

  // The options of a sensor: lengths in pixels are those of the default for 640 pixels of width and more, and in
  // proportion to the width, down to half of them, for fewer (core/detection/README.md, section 5).
  static PlaneDetectorOptions ForSensor(SensorGeometry geometry);
  // Options of the detectors that a search tries in turn: the lines of an object that is small in the image of a small
  // sensor need ForSensor(), sparse events about long lines need the default.
  static std::vector<PlaneDetectorOptions> ForSearch(SensorGeometry geometry);

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Creates the detector with the stages of core/detection/README.md. The paper intersects the planes with t = begin and
// t = end. Here the planes are the start of a robust fit to all events, which includes the rotation and acceleration of
// an edge. Each event belongs to one line; lines end where their events end or where two lines meet; the pieces of an
// edge and the two sides of a stripe are merged. Errors: INVALID_ARGUMENT for options, naming the field, or for a
// sensor without pixels.
absl::StatusOr<std::unique_ptr<LineDetector>> MakePlaneLineDetector(const PlaneDetectorOptions& options,
                                                                    SensorGeometry geometry);

}  // namespace evpose
