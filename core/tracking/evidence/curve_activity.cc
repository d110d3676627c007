// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/curve_activity.h"

#include <algorithm>
#include <cmath>

#include "core/contours/edge_elements.h"

namespace evpose {
namespace {

// Whether the events of the line decide if it is expected to have any. Straight lines with the prior contrast 1 always
// are.
bool IsActivityLearned(const TrackedLine& line) { return line.is_element || line.prior_contrast < 1.0f; }

}  // namespace

Expectation CurveActivity::Of(const TrackedLine& line) const {
  // A curve is expected to have events from then on if it has this number of events and this multiple of the least
  // rate: another cause is then unlikely, and curves with contrast have ten times the least rate.
  constexpr double kMinEvents = 20.0;
  constexpr double kConfirmFactor = 2.0;
  // Swept area without the expected events after which a curve is expected to have none: at the least rate it would
  // have caused 60 events.
  constexpr double kNoEventsPx2 = 400.0;
  // Prior contrast of creases, boundaries and painted lines from which on they count as straight lines do: between that
  // of a crease of 40 degrees, which most light shows, and that of a lesser one (core/contours/README.md, section 4).
  constexpr float kHighContrast = 0.7f;
  if (!IsActivityLearned(line)) return Expectation::kEvents;
  const Counts& counts = counts_[static_cast<size_t>(line.curve)];
  const double least = min_events_per_px2_ * counts.swept_px2;
  if (counts.events >= std::max(kMinEvents, kConfirmFactor * least)) return Expectation::kEvents;
  if (counts.swept_px2 >= kNoEventsPx2 && counts.events < least * line.prior_contrast) return Expectation::kNothing;
  if (line.prior_contrast <= kStepContrast) return Expectation::kNothing;
  const bool is_fixed = line.kind != EdgeKind::kContour;
  return is_fixed && line.prior_contrast >= kHighContrast ? Expectation::kEvents : Expectation::kPerhaps;
}

void CurveActivity::Add(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                        absl::Span<const double> line_events) {
  // Swept area over which the rate is averaged: an arc of 60 px at 300 px/s sweeps it in 60 ms. The background of a
  // contour changes within such times.
  constexpr double kMemoryPx2 = 1000.0;
  constexpr double kOwnWidthPx = 2.0;  // events of the background within it are attributed to a line
  ForEachCurve(input.lines, [&](size_t first, size_t end) {
    if (!IsActivityLearned(input.lines[first])) return;
    Counts& counts = counts_[static_cast<size_t>(input.lines[first].curve)];
    for (size_t k = first; k < end; ++k) {
      if (!lines[k].in_view()) continue;
      const double noise = input.background_per_px2 * kOwnWidthPx * lines[k].length_px;
      counts.events += line_events[k] * input.sampling.mean_events_per_observation - noise;
      counts.swept_px2 += lines[k].length_px * std::abs(NormalSpeedPxPerS(camera, lines[k], 0.5)) * input.duration_s;
    }
    const double keep = std::min(1.0, kMemoryPx2 / std::max(counts.swept_px2, 1.0));
    counts.swept_px2 *= keep;
    counts.events = std::max(0.0, keep * counts.events);
  });
}

}  // namespace evpose
