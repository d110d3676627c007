// SPDX-License-Identifier: Apache-2.0

// Flicker of the light: a line in the spectrum of the signed event rate that all parts of the image have in common
// (core/diagnosis/README.md, section 3).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/diagnosis/diagnosis_options.h"
#include "core/events/event.h"

namespace evpose {

class FlickerSpectrum {
 public:
  explicit FlickerSpectrum(SensorGeometry geometry);

  // Events in the order of the stream, inside the geometry.
  void Add(absl::Span<const Event> events);

  struct Line {
    double frequency_hz = 0.0;
    double share = 0.0;       // of the events that the flicker causes, in [0, 1]
    double coherence = 0.0;   // magnitude of the sum over the parts of the image, per sum of their magnitudes
    double num_parts = 0.0;   // among which the line is distributed
    double prominence = 0.0;  // ratio of its power and that of the frequencies beside it
  };
  struct Result {
    int num_segments = 0;     // of 0.256 s, half overlapping; 0: the recording is too short, or has too few events
    std::vector<Line> lines;  // significant ones, the strongest first
  };
  Result Measure(const DiagnosisOptions& options) const;

 private:
  // Parts of the image along each side. More parts have fewer events each; with fewer, lamps and moving objects share a
  // part.
  static constexpr int kSide = 8;
  static constexpr int kParts = kSide * kSide;
  static constexpr int64_t kBinUs = 500;  // spectrum up to 1 kHz
  static constexpr int kBins = 512;       // of a segment: 3.9 Hz
  static constexpr int kFrequencies = kBins / 2;
  struct Counts {
    std::array<int32_t, kParts> sum = {};         // of ON and OFF events
    std::array<int32_t, kParts> difference = {};  // ON events less OFF events
  };

  // Adds the segment of the bins from begin_bin_ on to the spectra.
  void AddSegment();
  void Advance(int64_t bin);

  const SensorGeometry geometry_;
  bool has_begun_ = false;
  int64_t begin_us_ = 0;
  int64_t begin_bin_ = 0;                 // of the open segment
  std::vector<Counts> bins_;              // of the open segment
  std::vector<double> window_, cosines_;  // Hann window; one period of a cosine
  int num_segments_ = 0;
  double weighted_events_ = 0.0;                             // sum of window times events
  std::array<double, kFrequencies> common_power_ = {};       // of the sum over the parts
  std::array<double, kFrequencies> power_ = {};              // sum of the parts' powers
  std::array<double, kFrequencies> magnitude_ = {};          // sum of the parts' magnitudes
  std::array<double, kFrequencies> squared_magnitude_ = {};  // squares of these sums for each segment
  std::array<double, kFrequencies> amplitude_ = {};          // of the sum over the parts, sum over the segments
};

}  // namespace evpose
