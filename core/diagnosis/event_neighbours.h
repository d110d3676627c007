// SPDX-License-Identifier: Apache-2.0

// The share of noise: events without neighbours (core/diagnosis/README.md, section 2).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose {

class EventNeighbours {
 public:
  explicit EventNeighbours(SensorGeometry geometry);

  // Events in the order of the stream, inside the geometry. Replaces `ages_us` by the time since the latest earlier
  // event of the 8 pixels around each event; kNoNeighbour if there was none, 0 if the clock stepped back.
  void Add(absl::Span<const Event> events, std::vector<int64_t>& ages_us);
  static constexpr int64_t kNoNeighbour = INT64_MAX;

  // The largest share of noise that is compatible with the ages, over a recording of this duration, in [0, 1]; 0
  // without events.
  double NoiseShare(int64_t duration_us) const;

 private:
  static constexpr int kStepsPerOctave = 4;              // bins of the ages, logarithmic: a step is at most a quarter
  static constexpr int kNumBins = 30 * kStepsPerOctave;  // to 2^30 us
  static int BinOf(int64_t age_us);
  static double LowerEdgeUs(int bin);

  const SensorGeometry geometry_;
  const size_t stride_;
  std::vector<int64_t> last_us_;  // of each pixel, with a frame of one pixel; kNeverHadEvent without one
  std::array<uint64_t, kNumBins + 1> ages_ = {};
  uint64_t num_events_ = 0;
};

}  // namespace evpose
