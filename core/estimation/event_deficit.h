// SPDX-License-Identifier: Apache-2.0

// Events that the motion of an object should have caused and that were not observed (core/estimation/README.md,
// section 4).
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/estimation/estimator.h"
#include "core/estimation/mixture_pass.h"

namespace evpose {

// Computes the expected and the observed events of each half line in a window for `twist` (core/estimation/README.md,
// section 4). `sums` are those of the last pass; lines without Expectation::kEvents have no counts, and the observed
// events of a curve are divided among its elements in proportion to the expected ones (PoolCounts). Of the explained
// events of a line, `noise_per_px` per pixel of its length are attributed to the background; `min_events_per_px2` is
// that of MixtureOptions. `deficit_counts` is overwritten with one entry per line.
void CountForDeficit(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                     absl::Span<const MixtureLine> sums, const Vector6d& twist, double noise_per_px,
                     double min_events_per_px2, std::vector<DeficitCounts>& deficit_counts);

// Divides the observed events of several elements of one curve among them in proportion to their expected events: a
// single element is expected to produce less than one event in a window.
void PoolCounts(absl::Span<DeficitCounts> counts);

// Adds the event deficit (core/estimation/README.md, equation (10)) to the normal equations of the twist and returns
// the missing share of the expected events, in [0, 1].
//
// Where `deficit_counts` has fewer observed events than expected ones, a one-sided Poisson penalty, multiplied by
// `scale`, reduces the estimated speed of the half line. `deficit_counts` are those for `twist`. The penalty grows
// from zero with the missing share of the expected events of the whole object beyond one half: with a smaller share the
// lines without events may be occluded, and the penalty would pull the object away from its visible lines. An excess of
// one line does not compensate for a deficit of another one, because it is caused by something else that passes. In a
// single window a slow line is expected to produce a tenth of an event and usually produces none; `past`, the counts of
// earlier windows for the same lines, or empty, distinguishes this from a deficit.
double AddEventDeficit(const CameraModel& camera, absl::Span<const ImageLine> lines,
                       absl::Span<const DeficitCounts> deficit_counts, absl::Span<const DeficitCounts> past,
                       const Vector6d& twist, double scale, Matrix12d& hessian, Vector12d& gradient);

}  // namespace evpose
