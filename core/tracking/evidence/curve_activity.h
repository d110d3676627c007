// SPDX-License-Identifier: Apache-2.0

// Which curves and contours of an object show events: a contour against a background that is as bright as the object
// shows none, and neither does a crease between faces in the same light (core/tracking/README.md, section 1).
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/estimation/estimator.h"

namespace evpose {

// Averages the event rate of each edge curve over its last motion. Straight lines with the prior contrast 1 are always
// expected to have events.
class CurveActivity {
 public:
  // `min_events_per_px2`: MixtureOptions.
  CurveActivity(int num_curves, double min_events_per_px2)
      : min_events_per_px2_(min_events_per_px2), counts_(static_cast<size_t>(num_curves)) {}

  Expectation Of(const TrackedLine& line) const;

  // Adds a window in which the pose was that of a confirmed track. `lines` are the images of `input.lines`, and
  // `line_events` is WindowFit::line_events.
  void Add(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
           absl::Span<const double> line_events);

  static void VisitState(auto& archive, auto& self) {
    auto& [min_events_per_px2, counts] = self;
    for (auto& of_curve : counts) archive(of_curve);
  }

 private:
  struct Counts {
    double events = 0.0;     // beyond those of the background
    double swept_px2 = 0.0;  // area that the curve swept while they occurred
    static void VisitState(auto& archive, auto& self) {
      auto& [events, swept_px2] = self;
      constexpr double kMax = 1e9;  // far above the memory of curve_activity.cc
      bool is_empty = events == 0 && swept_px2 == 0;
      archive(is_empty);
      if (!is_empty) archive(InRange(events, -kMax, kMax), InRange(swept_px2, 0.0, kMax));
    }
  };
  double min_events_per_px2_;
  std::vector<Counts> counts_;  // indexed by TrackedLine::curve
};

}  // namespace evpose
