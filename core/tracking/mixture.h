// Pose and twist of a window by expectation-maximisation over a normal + uniform mixture, under the motion prior
// (method.md 2.6 to 2.8).
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "core/tracking/edge_bias.h"
#include "core/tracking/estimator.h"
#include "core/tracking/line_clutter.h"
#include "core/tracking/line_sums.h"
#include "core/tracking/robust.h"

namespace evpose {

// What a pass over the events leaves of one line.
struct MixtureLine {
  LineSums sums;
  EdgeCounts counts;
  std::array<double, 2> half_weight = {};  // explained events of its first and its second half
  std::array<ByPolarity, 2> beside = {};   // LineCounts::beside
  double doubtful_px2 = 0.0;               // sum of w (1 - w) d^2
  // What the events tell of where the line is, as a share of what they would, were it known which are the line's: the
  // missing information principle (Louis, "Finding the observed information matrix when using the EM algorithm", 1982).
  double ObservedRatio(double sigma_px) const;
};

struct MixtureTotals {
  double num_gated = 0.0;
  double weight = 0.0;
  double weighted_squares_px2 = 0.0;
};

// One pass: shares every event between its two nearest lines, other objects and the clutter beside the nearest line
// (one entry of `densities` for each line), and sums by line. `sums` has one entry per image line and is overwritten.
MixtureTotals AccumulateMixture(const WindowInput& input, absl::Span<const ImageLine> lines,
                                const MixtureDensity& density, absl::Span<const LineDensities> densities,
                                const ExpTable& table, std::vector<MixtureLine>& sums);

// What the lines should have made and made in a window, by this twist. Of the events explained, `noise_per_px` for each
// pixel of a line's length come from the background, moving or not.
void CountAnswers(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                  absl::Span<const MixtureLine> sums, const Vector6d& twist, double noise_per_px,
                  double min_events_per_px2, std::vector<LineAnswer>& answers);

// The evidence of absence (method.md 2.10 (1)): a line that moves across itself makes events. Where fewer came than
// `answers` expects of the twist, it is braked; a one-sided Poisson penalty, added for the twist alone.
// Only as far as more than half of what the object should make is missing: while most of it speaks, silent lines are
// hidden, and braking them would drag the object away from what is seen. What one line makes too much does not make up
// for another's silence: it is something else's that passes. In a window, a slow line should make a tenth of an event,
// and mostly makes none; `past`, of the same lines or empty, tells that from silence. Returns the missing share.
double AddAbsence(const CameraModel& camera, absl::Span<const ImageLine> lines, absl::Span<const LineAnswer> answers,
                  absl::Span<const LineAnswer> past, const Vector6d& twist, double scale, Matrix12d& hessian,
                  Vector12d& gradient);

}  // namespace evpose
