// SPDX-License-Identifier: Apache-2.0

// The checks of RecordingDiagnosis: what they say, and what to do.
#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/counted.h"
#include "core/diagnosis/recording_diagnosis.h"

namespace evpose {
namespace {

constexpr size_t kMaxPlaces = 10;  // pixels, areas or frequencies that a finding lists, so that it stays readable
constexpr char kSettings[] = " (deploy/sensors/README.md)";

// Share of the pixels with events, from which on most dead areas have a rim with events.
constexpr double kMinBusyShare = 0.5;
// Events for the ratio of the thresholds, and passages for the blur: ratio and median then vary by less than a tenth.
constexpr double kMinPolarityEvents = 1000.0;
constexpr uint64_t kMinPassages = 60;
// A limit between the exponents of blurred edges and of light that changes in place.
constexpr double kMinBlurExponent = 0.5;

std::string Seconds(int64_t t_us) { return absl::StrFormat("%.6f s", 1e-6 * static_cast<double>(t_us)); }

std::string Percent(double share) { return absl::StrFormat("%.3g %%", 100.0 * share); }

Finding Named(const char* check) {
  Finding finding;
  finding.check = check;
  return finding;
}

// Events and pieces that the reader of a container skipped because they were damaged.
struct LostParts {
  uint64_t events = 0;
  uint64_t pieces = 0;
  std::vector<std::string> descriptions;
};

LostParts Lost(const std::vector<SkippedParts>& skipped) {
  LostParts lost;
  for (const SkippedParts& parts : skipped) {
    if (parts.loss == SkippedParts::Loss::kNone) continue;
    (parts.loss == SkippedParts::Loss::kEvents ? lost.events : lost.pieces) += parts.count;
    lost.descriptions.push_back(absl::StrCat("left out: ", parts.count, " ", parts.what));
  }
  return lost;
}

}  // namespace

Finding RecordingDiagnosis::CheckDecoding(const StreamFacts& facts) const {
  Finding finding = Named("decoding");
  const DecodeCounts& counts = facts.counts;
  const double words = std::max(1.0, static_cast<double>(facts.data_bytes) / facts.word_bytes);
  const LostParts lost = Lost(facts.skipped);
  const double missing = static_cast<double>(counts.dropped_outside_sensor + lost.events);
  // A recording may begin anywhere: events before the first time stamp are no fault.
  SetVerdict(std::max(static_cast<double>(counts.invalid_words()) / words,
                      missing / std::max(1.0, static_cast<double>(counts.cd_events) + missing)),
             options_.decode_fault_share, "share of the words or events", finding);
  // How many events a lost piece had is unknown. A long gap is a problem of the clock.
  if (lost.pieces > 0) finding.verdict = std::max(finding.verdict, Verdict::kAdvice);
  finding.text =
      absl::StrFormat("%d events decoded; %s, %s outside the sensor, %s at the end that %s no word", counts.cd_events,
                      Counted(counts.invalid_words(), "invalid word"), Counted(counts.dropped_outside_sensor, "event"),
                      Counted(facts.truncated_bytes, "byte"), facts.truncated_bytes == 1 ? "is" : "are");
  finding.places = lost.descriptions;
  if (counts.cd_events == 0) {
    finding.verdict = Verdict::kProblem;
    finding.text = "there is no event";
    finding.remedy = "check that the camera was recording, and that the format in the header is that of the data";
  } else if (finding.verdict != Verdict::kOk) {
    finding.remedy =
        counts.invalid_words() > 0 || !lost.descriptions.empty()
            ? "bytes were lost or changed: copy the file again, lower the event rate to that of the link, or record to "
              "a faster disk"
            : "the size of the sensor in the header, or of --camera, is smaller than that of the recording";
  }
  return finding;
}

Finding RecordingDiagnosis::CheckClock(const ClockWatch::Result& clock, const StreamFacts& facts) const {
  Finding finding = Named("clock");
  const auto step_back_us = static_cast<double>(clock.largest_step_back_us);
  const double gap_us = clock.gaps.empty() ? 0.0 : static_cast<double>(clock.gaps.front().duration_us);
  Finding gaps = finding;
  SetVerdict(step_back_us, options_.step_back_us, "us", finding);
  SetVerdict(gap_us, options_.gap_us, "us", gaps);
  // The count is the decoder's, as in `evpose info`; it includes time words without events.
  finding.text = absl::StrCat("time stamps step back ", Counted(facts.counts.time_backsteps, "time"),
                              "; the largest step between events is ", clock.largest_step_back_us, " us; ",
                              Counted(clock.num_gaps, "gap"));
  if (finding.verdict != Verdict::kOk) {
    finding.places.push_back(absl::StrCat("step back to ", Seconds(clock.largest_step_back_at_us)));
    finding.remedy =
        finding.verdict == Verdict::kProblem
            ? "the clock was reset or two recordings were joined: convert each part by itself, or restart the "
              "camera before recording"
            : "the events are slightly out of order, which tracking accepts; evpose convert keeps the order";
  }
  if (gaps.verdict > finding.verdict) {
    finding.verdict = gaps.verdict;
    finding.value = gaps.value;
    finding.limit = gaps.limit;
  }
  for (const ClockWatch::Gap& gap : clock.gaps) {
    std::string place =
        absl::StrFormat("no events for %.3f ms from %s on, where %.0f would be usual",
                        1e-3 * static_cast<double>(gap.duration_us), Seconds(gap.begin_us), gap.expected_events);
    // The clocks of EVT3, of DAT and FLAT64, and of EVT2 (core/events/README.md). One per cent allows for the time
    // between the events beside the gap.
    for (const int bits : {24, 32, 34}) {
      const double period_us = std::ldexp(1.0, bits);
      if (std::abs(static_cast<double>(gap.duration_us) - period_us) < 0.01 * period_us) {
        absl::StrAppend(&place, "; this is an overflow of a clock of ", bits, " bits");
      }
    }
    finding.places.push_back(place);
  }
  if (!clock.gaps.empty() && finding.remedy.empty()) {
    finding.remedy = absl::StrCat(
        "data were lost: the link, the recorder or the event rate control could not keep up, or the shutter of a lamp "
        "was closed; lower the event rate",
        kSettings);
  }
  return finding;
}

Finding RecordingDiagnosis::CheckTimeSteps(const ClockWatch::Result& clock) const {
  if (clock.time_step_us == 0) return NotChecked("time-step", "there are too few different time stamps");
  Finding finding = Named("time-step");
  SetVerdict(static_cast<double>(clock.time_step_us), options_.time_step_us, "us", finding);
  finding.text = absl::StrCat("time stamps are multiples of ", clock.time_step_us, " us");
  if (finding.verdict != Verdict::kOk) {
    finding.remedy =
        "the times were rounded, or the events were made from frames: use the original recording, with the sensor's "
        "microseconds";
  }
  return finding;
}

Finding RecordingDiagnosis::CheckEventRate(const MotionSamples::Result& motion, const Shares& shares) const {
  Finding finding = Named("event-rate");
  constexpr double kSlicesPerSecond = 1e6 / MotionSamples::kSliceUs;
  const double rate = motion.busy_events_in_20_ms * kSlicesPerSecond;
  SetVerdict(rate, options_.event_rate_per_s, "events/s", finding);
  finding.text =
      absl::StrFormat("%.3f Mev/s in the middle of the time, %.3f Mev/s in its busiest tenth, %.3f Mev/s at most",
                      1e-6 * motion.median_events_in_20_ms * kSlicesPerSecond, 1e-6 * rate,
                      1e-6 * motion.largest_events_in_20_ms * kSlicesPerSecond);
  if (finding.verdict != Verdict::kOk) {
    finding.places.push_back(absl::StrCat("largest rate at ", Seconds(motion.busiest_us)));
    finding.remedy = absl::StrCat(
        "raise the thresholds (bias_diff_on, bias_diff_off), use a region of interest or a plain background, and set "
        "the event rate control to the rate of the link",
        kSettings);
    return finding;
  }
  const double useful = motion.busy_events_in_20_ms * (1.0 - shares.noise);
  if (useful < options_.min_events_in_20_ms) {
    finding.verdict = Verdict::kProblem;
    finding.value = useful * kSlicesPerSecond;
    finding.limit = options_.min_events_in_20_ms * kSlicesPerSecond;
    absl::StrAppend(&finding.text, absl::StrFormat("; without noise %.1f kev/s, of which tracking needs %.1f kev/s",
                                                   1e-3 * *finding.value, 1e-3 * *finding.limit));
    finding.remedy = absl::StrCat(
        "more events from the object: lower thresholds (bias_diff_on, bias_diff_off), more light and contrast, a "
        "faster motion, or a longer lens",
        kSettings);
  }
  return finding;
}

Finding RecordingDiagnosis::CheckMotion(const MotionSamples::Result& motion, const Shares& shares) const {
  if (shares.noise > options_.noise_share.problem) {
    return NotChecked("motion", "the noise hides the motion; see noise");
  }
  if (shares.flicker > options_.flicker_share.problem) {
    return NotChecked("motion", "the flicker hides the motion; see flicker");
  }
  Finding finding = Named("motion");
  const bool is_problem = motion.speed_px_per_s < options_.problem_speed_px_per_s;
  SetMeasured(motion.speed_px_per_s, is_problem ? options_.problem_speed_px_per_s : options_.advice_speed_px_per_s,
              "px/s", finding);
  finding.text = absl::StrFormat("edges move by %.3g px/s", motion.speed_px_per_s);
  if (motion.extent_px == 0.0) {
    finding.verdict = Verdict::kProblem;
    finding.text = "no region of the image has more events than the noise";
    finding.remedy = "record the object while it moves, or lower the thresholds; an object at rest makes no events";
  } else if (motion.speed_px_per_s < options_.advice_speed_px_per_s) {
    finding.verdict = is_problem ? Verdict::kProblem : Verdict::kAdvice;
    finding.remedy =
        "a faster motion: a first pose is found while edges move by some pixels in a second; or --init-pose";
  }
  return finding;
}

Finding RecordingDiagnosis::CheckNoise(const Shares& shares) const {
  const double seconds = 1e-6 * static_cast<double>(duration_us());
  const double pixels = 1.0 * geometry_.width_px * geometry_.height_px;
  const double rate = seconds > 0.0 ? shares.noise * static_cast<double>(num_events()) / (seconds * pixels) : 0.0;
  if (!shares.has_signal) {
    return NotChecked("noise", absl::StrFormat("nothing moves: all events may be noise, %.2g Hz per pixel", rate));
  }
  Finding finding = Named("noise");
  SetVerdict(shares.noise, options_.noise_share, "share of the events", finding);
  finding.text = absl::StrFormat("%s of the events are noise: %.2g Hz per pixel", Percent(shares.noise), rate);
  if (finding.verdict != Verdict::kOk) {
    finding.remedy = absl::StrCat(
        "more light, a wider aperture or higher thresholds (bias_diff_on, bias_diff_off); a camera's noise filter may "
        "remove isolated events, but not the second events of an edge (trail)",
        kSettings);
  }
  return finding;
}

Finding RecordingDiagnosis::CheckHotPixels() const {
  Finding finding = Named("hot-pixels");
  const std::vector<PixelCounts::HotPixel> hot = pixels_.FindHot(options_);
  double hot_events = 0.0;
  for (const PixelCounts::HotPixel& pixel : hot) hot_events += static_cast<double>(pixel.events);
  // Lower bound of the denominator: the least number of events for tracking, so that the share is not large only
  // because nothing moves.
  const double needed = options_.min_events_in_20_ms * static_cast<double>(duration_us()) / MotionSamples::kSliceUs;
  const double share = hot_events / std::max(static_cast<double>(num_events()), needed);
  SetVerdict(share, options_.hot_share, "share of the events", finding);
  finding.text = absl::StrFormat("%s, with %s of the events", Counted(hot.size(), "hot pixel"), Percent(share));
  const double seconds = 1e-6 * static_cast<double>(duration_us());
  for (size_t i = 0; i < std::min(hot.size(), kMaxPlaces); ++i) {
    finding.places.push_back(absl::StrFormat("pixel (%d, %d): %d events, %.0f Hz", hot[i].x, hot[i].y, hot[i].events,
                                             seconds > 0.0 ? static_cast<double>(hot[i].events) / seconds : 0.0));
  }
  if (finding.verdict != Verdict::kOk) {
    finding.remedy =
        "mask these pixels in the camera (Metavision: digital event mask, or active pixel detection), and let the "
        "sensor warm up before";
  }
  return finding;
}

Finding RecordingDiagnosis::CheckDeadPixels(const Shares& shares) const {
  Finding finding = Named("dead-pixels");
  const double pixels = 1.0 * geometry_.width_px * geometry_.height_px;
  const double noise_per_pixel = shares.noise * static_cast<double>(num_events()) / pixels;
  const std::vector<PixelCounts::DeadArea> areas = pixels_.FindDead(noise_per_pixel, options_);
  const double busy_share = pixels_.BusyShare();
  if (areas.empty() && busy_share < kMinBusyShare) {
    return NotChecked(
        "dead-pixels",
        absl::StrFormat("only %s of the pixels have %d events or more, and the check needs half of them: record a "
                        "moving pattern that fills the image",
                        Percent(busy_share), PixelCounts::kMinRimEvents));
  }
  double silent = 0.0;
  for (const PixelCounts::DeadArea& area : areas) silent += static_cast<double>(area.pixels);
  SetVerdict(silent / pixels, options_.dead_share, "share of the pixels", finding);
  finding.text = areas.empty() ? "no area without events has events all around it"
                               : absl::StrCat(Counted(areas.size(), "area"), " without any event, ",
                                              Percent(silent / pixels), " of the pixels");
  for (size_t i = 0; i < std::min(areas.size(), kMaxPlaces); ++i) {
    const PixelCounts::DeadArea& area = areas[i];
    finding.places.push_back(absl::StrFormat("columns %d to %d, rows %d to %d: %d pixels", area.x_min, area.x_max,
                                             area.y_min, area.y_max, area.pixels));
  }
  if (finding.verdict != Verdict::kOk) {
    finding.remedy = absl::StrCat(
        "a region of interest or a mask of the camera, or dead pixels: move the object elsewhere, or remove the mask",
        kSettings);
  }
  return finding;
}

Finding RecordingDiagnosis::CheckFlicker(const FlickerSpectrum::Result& spectrum) const {
  if (spectrum.num_segments == 0) {
    return NotChecked("flicker", "the spectrum needs 0.26 s without a gap, with events in a quarter of the image");
  }
  Finding finding = Named("flicker");
  if (spectrum.lines.empty()) {
    SetVerdict(0.0, options_.flicker_share, "share of the events", finding);
    finding.text = absl::StrFormat("no frequency from %.0f to 1000 Hz is common to all parts of the image",
                                   options_.min_flicker_hz);
    return finding;
  }
  const FlickerSpectrum::Line& line = spectrum.lines.front();
  SetVerdict(line.share, options_.flicker_share, "share of the events", finding);
  finding.text = absl::StrFormat("%s of the events come from light that flickers at %.1f Hz", Percent(line.share),
                                 line.frequency_hz);
  for (size_t i = 0; i < std::min(spectrum.lines.size(), kMaxPlaces); ++i) {
    const FlickerSpectrum::Line& each = spectrum.lines[i];
    finding.places.push_back(
        absl::StrFormat("%.1f Hz: %s of the events, %.0f times the power beside it, %.0f %% of it common",
                        each.frequency_hz, Percent(each.share), each.prominence, 100.0 * each.coherence));
  }
  if (finding.verdict == Verdict::kAdvice) {
    finding.remedy = absl::StrCat(
        "tracking removes most of these events itself; a lamp on direct current makes poses more accurate", kSettings);
  } else if (finding.verdict == Verdict::kProblem) {
    finding.remedy = absl::StrCat(
        "use another lamp (direct current), or the camera's anti-flicker filter: the object is lost otherwise",
        kSettings);
  }
  return finding;
}

Finding RecordingDiagnosis::CheckPolarity(const Shares& shares) const {
  const ByPolarity& events = runs_.events();
  if (shares.flicker > options_.flicker_share.problem) {
    return NotChecked("polarity", "the flicker causes the events of both polarities; see flicker");
  }
  if (events[0] + events[1] < kMinPolarityEvents) {
    return NotChecked("polarity", absl::StrFormat("%.0f events have a neighbour; the ratio needs %.0f",
                                                  events[0] + events[1], kMinPolarityEvents));
  }
  const double ratio = (events[1] + 1.0) / (events[0] + 1.0);
  Finding finding = Named("polarity");
  SetVerdict(std::max(ratio, 1.0 / ratio), options_.polarity_ratio, "ratio", finding);
  finding.text = absl::StrFormat("%.2f ON events for each OFF event", ratio);
  if (finding.verdict != Verdict::kOk) {
    finding.remedy = absl::StrCat(
        ratio > 1.0 ? "raise bias_diff_on or lower bias_diff_off" : "raise bias_diff_off or lower bias_diff_on",
        " until both polarities have about as many events, then evpose calibrate", kSettings);
  }
  return finding;
}

Finding RecordingDiagnosis::CheckFocus(const Shares& shares) const {
  const PixelRuns::Blur blur = runs_.MeasureBlur();
  if (shares.flicker > options_.flicker_share.advice) {
    return NotChecked("focus", "the flicker hides the passages of edges; see flicker");
  }
  if (blur.num_passages < kMinPassages) {
    return NotChecked("focus",
                      absl::StrCat(Counted(blur.num_passages, "passage"),
                                   " of an edge with three events of a pixel; the median needs ", kMinPassages));
  }
  if (!blur.has_speeds) {
    return NotChecked("focus", "all edges move at one speed, as on a screen that is drawn line by line");
  }
  if (blur.median_px > options_.blur_px.advice && blur.exponent < kMinBlurExponent) {
    return NotChecked("focus", "edges are wide in time at every speed: the cause is slow pixels, not a blurred lens");
  }
  Finding finding = Named("focus");
  SetVerdict(blur.median_px, options_.blur_px, "px", finding);
  finding.text = absl::StrFormat("edges are blurred by %.2f px (standard deviation)", blur.median_px);
  if (finding.verdict != Verdict::kOk) {
    finding.remedy = absl::StrCat(
        "focus the lens at the distance of the object, with a smaller aperture and more light; raise bias_fo if edges "
        "lag",
        kSettings);
  }
  return finding;
}

}  // namespace evpose
