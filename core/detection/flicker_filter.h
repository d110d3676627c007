// SPDX-License-Identifier: Apache-2.0

// Removes most of the events that a flickering light causes. While the brightness of a lamp changes, all surfaces
// produce events of one polarity, and the few events of the other polarity are caused by moving edges. In steady light,
// and on average over the period of the lamp, the ratio of ON and OFF events is nearly constant.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "absl/types/span.h"
#include "core/detection/line_detector.h"
#include "core/numerics/sampling.h"

namespace evpose {

// Deterministic. Reuses memory, but keeps no state between calls.
class FlickerFilter {
 public:
  // Downsamples `events`, which must be in order of time. In each slice of 0.5 ms the number of events of one polarity
  // that edges may have produced is estimated from the events of the other polarity and the usual ratio. The larger the
  // excess over it, the fewer events are kept. A change in the motion of edges causes no excess, because edges produce
  // both polarities; neither does a constant excess of one polarity. The result is valid until the next call.
  absl::Span<const PixelEvent> Remove(absl::Span<const PixelEvent> events);

 private:
  using Counts = std::array<size_t, 2>;  // OFF and ON
  std::vector<Counts> slices_;
  std::vector<SelectionSampler> samples_;  // two for each slice: OFF and ON
  std::vector<PixelEvent> kept_;
};

}  // namespace evpose
