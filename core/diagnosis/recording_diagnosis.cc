// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/recording_diagnosis.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// Events for statistics over a recording.
constexpr uint64_t kMinEvents = 1000;

}  // namespace

absl::StatusOr<RecordingDiagnosis> RecordingDiagnosis::Make(SensorGeometry geometry, const DiagnosisOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  const int64_t pixels = int64_t{geometry.width_px} * geometry.height_px;
  if (geometry.width_px <= 0 || geometry.height_px <= 0 || pixels > options.max_pixels) {
    return absl::InvalidArgumentError(absl::StrCat("a sensor of ", geometry.width_px, "x", geometry.height_px,
                                                   " pixels cannot be diagnosed: at most ", options.max_pixels,
                                                   " pixels; the size is that of the header or of the camera"));
  }
  return RecordingDiagnosis(geometry, options);
}

RecordingDiagnosis::RecordingDiagnosis(SensorGeometry geometry, const DiagnosisOptions& options)
    : geometry_(geometry),
      options_(options),
      pixels_(geometry),
      neighbours_(geometry),
      runs_(geometry),
      flicker_(geometry),
      motion_(geometry) {}

void RecordingDiagnosis::Add(absl::Span<const Event> events) {
  const auto is_outside = [this](const Event& event) {
    return event.x >= geometry_.width_px || event.y >= geometry_.height_px;
  };
  if (std::any_of(events.begin(), events.end(), is_outside)) {
    inside_.clear();
    std::remove_copy_if(events.begin(), events.end(), std::back_inserter(inside_), is_outside);
    events = inside_;
  }
  if (events.empty()) return;
  if (pixels_.num_events() == 0) {
    t_first_us_ = events.front().t_us;
    t_last_us_ = t_first_us_;
  }
  for (const Event& event : events) t_last_us_ = std::max(t_last_us_, event.t_us);
  pixels_.Add(events);
  neighbours_.Add(events, ages_us_);
  runs_.Add(events, ages_us_);
  flicker_.Add(events);
  clock_.Add(events);
  motion_.Add(events);
}

std::vector<Finding> RecordingDiagnosis::Findings(const StreamFacts& facts) const {
  std::vector<Finding> findings = {CheckDecoding(facts)};
  if (num_events() < kMinEvents) {
    for (const char* check : {"clock", "time-step", "event-rate", "motion", "noise", "hot-pixels", "dead-pixels",
                              "flicker", "polarity", "focus"}) {
      findings.push_back(
          NotChecked(check, absl::StrCat("there are ", num_events(), " events; the statistics need ", kMinEvents)));
    }
    return findings;
  }
  const ClockWatch::Result clock = clock_.Measure();
  const MotionSamples::Result motion = motion_.Measure();
  const double noise_share = neighbours_.NoiseShare(duration_us());
  double hot_events = 0.0;
  double flicker_share = 0.0;
  const Finding hot = CheckHotPixels(hot_events);
  const Finding flicker = CheckFlicker(flicker_share);
  findings.push_back(CheckClock(clock));
  findings.push_back(CheckTimeSteps(clock));
  findings.push_back(CheckEventRate(motion, noise_share));
  findings.push_back(CheckMotion(motion, noise_share));
  findings.push_back(CheckNoise(noise_share));
  findings.push_back(hot);
  findings.push_back(CheckDeadPixels(noise_share));
  findings.push_back(flicker);
  findings.push_back(CheckPolarity(flicker_share));
  findings.push_back(CheckFocus(flicker_share));
  return findings;
}

}  // namespace evpose
