// SPDX-License-Identifier: Apache-2.0

// Where edges are at one time, with their directions and their motion, from events
// (core/initialization/templates/README.md, section 2).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/detection/event_stretch.h"
#include "core/detection/line_detector.h"
#include "core/events/event.h"

namespace evpose {

// A piece of an edge at the middle of the stretch: the events of one polarity in one pixel and around it.
struct EventEdgePoint {
  Eigen::Vector2d at_px = Eigen::Vector2d::Zero();   // undistorted
  Eigen::Vector2d normal = Eigen::Vector2d::Zero();  // unit; the sign has no meaning
  // Velocity of the edge along its normal, px/s: the normal flow.
  Eigen::Vector2d flow_px_per_s = Eigen::Vector2d::Zero();
  float weight = 0.0f;  // number of events in the pixel
};

struct EventEdges {
  int64_t t_begin_us = 0;
  int64_t t_end_us = 0;
  double motion_px = 0.0;  // median motion of the edges during the stretch
  std::vector<EventEdgePoint> points;

  int64_t t_mid_us() const { return t_begin_us + (t_end_us - t_begin_us) / 2; }
};

// The defaults are validated by event_edges_test: places and motion of an edge at 30 to 3000 px/s, and hardly any edge
// in noise and at hot pixels.
struct EventEdgeOptions {
  // The latest events over this motion of the edges, pixels: enough for a plane in space and time, and less than the
  // distance of neighbouring edges. If an object moves by less in the latest 0.2 s, those of up to a second.
  StretchOptions stretch = {
      .motion_px = 3.0, .max_duration_us = 200'000, .max_slow_duration_us = 1'000'000, .max_events = 20'000};
  // Standard deviation of events about the plane of an edge above which a place is texture or noise, pixels. Rounding
  // to pixels and the response time of the sensor give 0.3 to 0.6 px.
  double max_scatter_px = 0.8;
  // Smallest number of events of one polarity within 2 px that determine a plane, which has three unknowns: twice as
  // many. With fewer the scatter about the plane is chance.
  int min_events = 6;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Deterministic; keeps no state between calls. Not thread-safe.
class EventEdgeDetector {
 public:
  EventEdgeDetector(const EventEdgeOptions& options, SensorGeometry sensor);

  // `events` are as LineDetector::Detect requires. The points are in order of the first events of their pixels.
  EventEdges Detect(absl::Span<const PixelEvent> events);

 private:
  const EventEdgeOptions options_;
  const SensorGeometry sensor_;
  StretchSelector selector_;
};

}  // namespace evpose
