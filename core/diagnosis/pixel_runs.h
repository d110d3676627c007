// SPDX-License-Identifier: Apache-2.0

// Runs: the consecutive events of one polarity of a pixel, as the passage of an edge produces them. Their lengths give
// the ratio of the thresholds, their durations the blur of edges (README.md, sections 4 and 6).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose {

class PixelRuns {
 public:
  explicit PixelRuns(SensorGeometry geometry);

  // Events in the order of the stream, inside the geometry, and the ages of their neighbours (EventNeighbours). Events
  // without a recent neighbour are ignored.
  void Add(absl::Span<const Event> events, absl::Span<const int64_t> ages_us);

  struct Balance {
    ByPolarity events = {0.0, 0.0};  // of the pairs of opposite runs
    uint64_t num_pairs = 0;
  };
  // A pair of opposite runs returns the light of a pixel about to where it was.
  Balance MeasureBalance() const;

  struct Blur {
    double median_px = 0.0;  // standard deviation; of the passages
    uint64_t num_passages = 0;
  };
  Blur MeasureBlur() const;

 private:
  struct Pixel {
    int64_t begin_us[2] = {kNever, kNever};  // of the latest run of each polarity
    int64_t last_us = kNever;                // of the latest run
    uint16_t length = 0;                     // of the latest run; saturates
    uint16_t previous_length = 0;            // of the run before it
    uint8_t polarity = 0;                    // of the latest run
    bool is_second = false;                  // the latest run is the second of a pair
    bool is_measured = false;                // the blur of the latest run has been measured
  };
  static constexpr int64_t kNever = INT64_MIN / 4;
  static constexpr int kBlurBins = 200;
  static constexpr double kBlurBinPx = 0.05;

  // Adds the passage of the latest run of a pixel to the histogram of blurs.
  void MeasurePassage(int x, int y);

  const SensorGeometry geometry_;
  std::vector<Pixel> pixels_;
  Balance balance_;
  std::array<uint64_t, kBlurBins> blurs_ = {};
};

}  // namespace evpose
