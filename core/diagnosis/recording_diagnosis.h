// SPDX-License-Identifier: Apache-2.0

// Checks the events of a recording, or of a live camera, for what prevents tracking or makes its poses worse. It reads
// the events once, in bounded memory: some 60 bytes for each pixel of the sensor and 10 MB.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/diagnosis/clock_watch.h"
#include "core/diagnosis/diagnosis_options.h"
#include "core/diagnosis/event_neighbours.h"
#include "core/diagnosis/finding.h"
#include "core/diagnosis/flicker_spectrum.h"
#include "core/diagnosis/motion_samples.h"
#include "core/diagnosis/pixel_counts.h"
#include "core/diagnosis/pixel_runs.h"
#include "core/events/decoder.h"
#include "core/events/event.h"
#include "core/recordings/recording_reader.h"

namespace evpose {

// What the reader of a recording knows beside its events.
struct StreamFacts {
  DecodeCounts counts;
  uint64_t data_bytes = 0;
  int word_bytes = 8;
  int truncated_bytes = 0;            // of an unfinished word at the end
  std::vector<SkippedParts> skipped;  // what the reader left out
};

class RecordingDiagnosis {
 public:
  // Errors: those of DiagnosisOptions::Validate(); INVALID_ARGUMENT for a geometry that is not positive or has more
  // than max_pixels.
  static absl::StatusOr<RecordingDiagnosis> Make(SensorGeometry geometry, const DiagnosisOptions& options = {});

  // Events in the order of the stream; those outside the geometry are left out.
  void Add(absl::Span<const Event> events);

  uint64_t num_events() const { return pixels_.num_events(); }
  int64_t duration_us() const { return num_events() == 0 ? 0 : t_last_us_ - t_first_us_; }
  const SensorGeometry& geometry() const { return geometry_; }
  const DiagnosisOptions& options() const { return options_; }
  MotionSamples::Result motion() const { return motion_.Measure(); }
  PixelCounts::Box extent() const { return pixels_.Extent(); }

  // One finding for each check, in the order of README.md. All but the first say "not checked" for too few events.
  std::vector<Finding> Findings(const StreamFacts& facts) const;

 private:
  RecordingDiagnosis(SensorGeometry geometry, const DiagnosisOptions& options);

  // Shares of the events, which decide what can be measured.
  struct Shares {
    double noise = 0.0;
    double flicker = 0.0;
    bool has_signal = true;  // enough events are neither
  };
  Shares MeasureShares(const MotionSamples::Result& motion, const FlickerSpectrum::Result& spectrum) const;

  Finding CheckDecoding(const StreamFacts& facts) const;
  Finding CheckClock(const ClockWatch::Result& clock, const StreamFacts& facts) const;
  Finding CheckTimeSteps(const ClockWatch::Result& clock) const;
  Finding CheckEventRate(const MotionSamples::Result& motion, const Shares& shares) const;
  Finding CheckMotion(const MotionSamples::Result& motion, const Shares& shares) const;
  Finding CheckNoise(const Shares& shares) const;
  Finding CheckHotPixels() const;
  Finding CheckDeadPixels(const Shares& shares) const;
  Finding CheckFlicker(const FlickerSpectrum::Result& spectrum) const;
  Finding CheckPolarity(const Shares& shares) const;
  Finding CheckFocus(const Shares& shares) const;
  std::vector<Finding> FewEvents() const;

  const SensorGeometry geometry_;
  const DiagnosisOptions options_;
  PixelCounts pixels_;
  EventNeighbours neighbours_;
  PixelRuns runs_;
  FlickerSpectrum flicker_;
  ClockWatch clock_;
  MotionSamples motion_;
  int64_t t_first_us_ = 0;
  int64_t t_last_us_ = 0;         // the largest time
  std::vector<int64_t> ages_us_;  // of one call
  std::vector<Event> inside_;
};

}  // namespace evpose
