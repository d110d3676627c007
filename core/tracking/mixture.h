// SPDX-License-Identifier: Apache-2.0

// Pose and twist of a window by expectation-maximisation over a normal + uniform mixture, under the motion prior
// (method.md 2.6 to 2.8).
#pragma once

#include <memory>
#include <vector>

#include "core/tracking/estimator.h"
#include "core/tracking/mixture_pass.h"

namespace evpose {

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
