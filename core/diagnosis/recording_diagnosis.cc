// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/recording_diagnosis.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// Events for statistics over a recording: shares of fewer events vary by more than 3 % of them.
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

RecordingDiagnosis::Shares RecordingDiagnosis::MeasureShares(const MotionSamples::Result& motion,
                                                             const FlickerSpectrum::Result& spectrum) const {
  Shares shares;
  shares.noise = neighbours_.NoiseShare(duration_us());
  if (!spectrum.lines.empty()) shares.flicker = spectrum.lines.front().share;
  shares.has_signal = motion.busy_events_in_20_ms * (1.0 - shares.noise) >= options_.min_events_in_20_ms;
  return shares;
}

std::vector<Finding> RecordingDiagnosis::FewEvents() const {
  const std::string reason = absl::StrCat("there are ", num_events(), " events; the statistics need ", kMinEvents);
  std::vector<Finding> findings;
  for (const char* check : {"clock", "time-step", "event-rate", "motion", "noise", "hot-pixels", "dead-pixels",
                            "flicker", "polarity", "focus"}) {
    findings.push_back(NotChecked(check, reason));
  }
  const double seconds = 1e-6 * static_cast<double>(duration_us());
  const double least = options_.min_events_in_20_ms * 1e6 / MotionSamples::kSliceUs;
  const double rate = static_cast<double>(num_events()) / std::max(seconds, 1e-6);
  if (num_events() == 0 || rate >= least) return findings;
  Finding& finding = findings[2];
  finding.verdict = Verdict::kProblem;
  SetMeasured(rate, least, "events/s", finding);
  finding.text = absl::StrFormat("%d events in %.3f s", num_events(), seconds);
  finding.remedy = "record the object while it moves: an object at rest makes no events";
  return findings;
}

std::vector<Finding> RecordingDiagnosis::Findings(const StreamFacts& facts) const {
  std::vector<Finding> findings = {CheckDecoding(facts)};
  if (num_events() < kMinEvents) {
    for (Finding& finding : FewEvents()) findings.push_back(std::move(finding));
    return findings;
  }
  const ClockWatch::Result clock = clock_.Measure();
  const MotionSamples::Result motion = motion_.Measure();
  const FlickerSpectrum::Result spectrum = flicker_.Measure(options_);
  const Shares shares = MeasureShares(motion, spectrum);
  findings.push_back(CheckClock(clock, facts));
  findings.push_back(CheckTimeSteps(clock));
  findings.push_back(CheckEventRate(motion, shares));
  findings.push_back(CheckMotion(motion, shares));
  findings.push_back(CheckNoise(shares));
  findings.push_back(CheckHotPixels());
  findings.push_back(CheckDeadPixels(shares));
  findings.push_back(CheckFlicker(spectrum));
  findings.push_back(CheckPolarity(shares));
  findings.push_back(CheckFocus(shares));
  return findings;
}

}  // namespace evpose
