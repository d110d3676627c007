// SPDX-License-Identifier: Apache-2.0

// Events without those of a lamp's flicker. While a lamp grows brighter or darker, surfaces send a flood of one
// polarity, and the few events of the other are the moving edges'; over the lamp's period, and in a steady light, a
// scene's ON and OFF events come in about the same ratio in every millisecond.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "absl/types/span.h"
#include "core/detection/line_detector.h"
#include "core/numerics/sampling.h"

namespace evpose {

// Keeps memory between calls, but no state. Deterministic.
class FlickerFilter {
 public:
  // Thins `events`, in order of time, in each slice of time by how much more of their polarity come in it than the
  // usual ratio and the events of the other lead to expect: the less of them are edges', the fewer of them stay. What
  // edges that begin or cease to move send stays, as it is of both polarities, and what comes of one polarity all the
  // time. Valid until the next call.
  absl::Span<const PixelEvent> Remove(absl::Span<const PixelEvent> events);

 private:
  using Counts = std::array<size_t, 2>;  // OFF and ON
  void CountSlices(absl::Span<const PixelEvent> events);

  std::vector<Counts> slices_;
  std::vector<SelectionSampler> samples_;  // of each slice, OFF and ON
  std::vector<PixelEvent> kept_;
};

}  // namespace evpose
