// SPDX-License-Identifier: Apache-2.0

// Runs: the consecutive events of one polarity of a pixel, as the passage of an edge produces them. Their numbers give
// the ratio of the thresholds, their durations the blur of edges (core/diagnosis/README.md, section 4, and section 6).
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

  // Number of the OFF and the ON events.
  const ByPolarity& events() const { return events_; }

  struct Blur {
    double median_px = 0.0;  // standard deviation; of the passages
    uint64_t num_passages = 0;
    // The duration of a passage is proportional to the time per pixel to this power: 1 for edges that are blurred in
    // the image, 0 for light that changes in place, as on a screen, or for slow pixels.
    double exponent = 1.0;
    bool has_speeds = false;  // the edges move at different speeds, which `exponent` needs
  };
  Blur MeasureBlur() const;

 private:
  struct Pixel {
    int64_t begin_us[2] = {kNever, kNever};  // of the latest passage, for each polarity
    int64_t last_us = kNever;                // of the latest event
    uint16_t length = 0;                     // events of the latest passage; saturates
    uint8_t polarity = 0;                    // of the latest passage
  };
  static constexpr int64_t kNever = INT64_MIN / 4;
  // The histogram extends to 10 px, more than the blur of a usable lens. Its median is interpolated within a bin.
  static constexpr int kBlurBins = 200;
  static constexpr double kBlurBinPx = 0.05;

  // Adds the latest passage of a pixel to the histogram of blurs.
  void MeasurePassage(int x, int y);

  const SensorGeometry geometry_;
  std::vector<Pixel> pixels_;
  ByPolarity events_ = {0.0, 0.0};
  std::array<uint64_t, kBlurBins> blurs_ = {};
  struct {
    double slope = 0.0, duration = 0.0, slope_slope = 0.0, slope_duration = 0.0;
  } sums_;  // of logarithms over the passages
};

}  // namespace evpose
