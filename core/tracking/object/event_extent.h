// SPDX-License-Identifier: Apache-2.0

// The extent of the image region in which something moves, to explain why a search detected no lines.
#pragma once

#include "absl/types/span.h"
#include "core/detection/line_detector.h"

namespace evpose {

// Below this extent an object has hardly three edges of LineSetOptions::min_length_px (20): the shorter ones of its
// edges are about half as long as the object. Validated by tracker_initialization_test: an object of 20 px is reported
// as too small.
inline constexpr int kMinSearchExtentPx = 40;

// Returns the larger side, in pixels, of the box of the events in the largest connected region whose event density
// exceeds that of the noise; 0 if there is no such region. `events` are in order of time. The box is the median over
// short times, so that the motion of the object does not enlarge it. Events outside the image are ignored.
int EventExtentPx(absl::Span<const PixelEvent> events, int width_px, int height_px);

}  // namespace evpose
