// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/health.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/association/competitors.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/numerics/reusable_vector.h"

namespace evpose {
namespace {

// Events of a line: fewer cannot reach the significance, even if all of them are near.
constexpr double kTestableEvents = 20.0;

// LineStatistics::lines of the elements of a curve, of a total length in pixels.
int NumLines(absl::Span<const TrackedLine> elements, absl::Span<const ImageLine> lines, double length_px) {
  // Pixels. A shorter arc has too few events to determine a direction, and could fit clutter.
  constexpr double kMinArcPx = 30.0;
  int arcs = 0;
  ForEachArc(elements, lines, [&](size_t, size_t) { ++arcs; });
  const int long_enough = static_cast<int>(std::min(length_px / kMinArcPx, LineStatistics::kMaxLines + 0.0));
  return std::max(1, std::min(arcs, long_enough));
}

}  // namespace

absl::Status HealthOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("gate_px", gate_px, 1.0, 64.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("near_px", near_px, 0.1, 0.5 * gate_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("significance_sigma", significance_sigma));
  EVPOSE_RETURN_IF_ERROR(CheckRange("dispersion", dispersion, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_noise_hz_per_px", max_noise_hz_per_px, 0.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_events", min_events, 1, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_span_us", static_cast<double>(min_span_us)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("confirm_support_ratio", confirm_support_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("keep_support_ratio", keep_support_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("confirm_lines", confirm_lines, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("keep_lines", keep_lines, 1, confirm_lines));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_signal_events", min_signal_events, 0.0, 1e6));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("memory_us", static_cast<double>(memory_us)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_tested_ratio", min_tested_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_hold_us", static_cast<double>(max_hold_us), 0.0, 1e9));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("patience_us", static_cast<double>(patience_us)));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("lost_after_us", static_cast<double>(lost_after_us)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_contradictions", max_contradictions, 1, 1000));
  return CheckPositive("max_uncertainty_px", max_uncertainty_px);
}

void LineStatistics::Add(const LineStatistics& other, double kept_ratio) {
  gated = kept_ratio * gated + other.gated;
  along = kept_ratio * along + other.along;
  excess = kept_ratio * excess + other.excess;
  variance = kept_ratio * variance + other.variance;
  noise = kept_ratio * noise + other.noise;
  expected = kept_ratio * expected + other.expected;
  length_px = kept_ratio * length_px + other.length_px;
  lines = std::max(lines, other.lines);
}

TrackHealth::TrackHealth(const HealthOptions& options, double min_events_per_px2, int num_curves)
    : options_(options),
      min_events_per_px2_(min_events_per_px2),
      statistics_(static_cast<size_t>(num_curves)),
      memory_(static_cast<size_t>(num_curves)) {}

void TrackHealth::Reset() {
  const double left = std::max(0.0, 1.0 - span_s_ * 1e6 / static_cast<double>(options_.memory_us));
  for (size_t k = 0; k < statistics_.size(); ++k) memory_[k].Add(statistics_[k], left);
  std::fill(statistics_.begin(), statistics_.end(), LineStatistics());
  span_s_ = 0.0;
  gated_ = 0.0;
  gate_px2_s_ = 0.0;
}

void TrackHealth::EnterLines(const WindowInput& input, absl::Span<const ImageLine> lines) {
  window_lines_.clear();
  places_.clear();
  ForEachCurve(input.lines, [&](size_t first, size_t end) {
    LineStatistics& evidence = statistics_[input.lines[first].curve];
    double length_px = 0.0;
    for (size_t k = first; k < end; ++k) {
      places_.push_back({window_lines_.size(), length_px});
      length_px += lines[k].length_px;
    }
    if (input.lines[first].is_element) {
      evidence.lines = std::max(evidence.lines, NumLines(input.lines.subspan(first, end - first),
                                                         lines.subspan(first, end - first), length_px));
    }
    window_lines_.push_back({&evidence, static_cast<double>(evidence.along.size()) / length_px, {}, {}});
  });
}

void TrackHealth::AddWindow(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                            const Vector6d& twist) {
  EnterLines(input, lines);
  AddEvents(*input.sorted, lines);
  for (const WindowLine& line : window_lines_) {
    for (int polarity = 0; polarity < 2; ++polarity) {
      line.evidence->gated += input.shares.polarity_weight[polarity] * line.gated_of[polarity];
      AddExcess(line.gated_of[polarity], line.near_of[polarity], *line.evidence);
    }
  }
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    if (!lines[k].in_view()) continue;
    const double gate_px2 = 2.0 * options_.gate_px * lines[k].length_px;
    const double observed_ratio = input.shares.observations_per_background_event;
    gate_px2_s_ += gate_px2 * input.duration_s * observed_ratio;
    LineStatistics& evidence = statistics_[input.lines[k].curve];
    evidence.noise += input.background_per_px2 * gate_px2 * observed_ratio;
    evidence.length_px += lines[k].length_px * input.duration_s;
    if (input.ExpectationOf(k) == Expectation::kNothing) continue;
    const double events_per_px2 = min_events_per_px2_ * lines[k].prior_contrast;
    for (const double fraction : {0.25, 0.75}) {
      const double speed = std::abs(BearingOf(camera, lines[k].PointAt(fraction)).dot(lines[k].jacobian * twist));
      evidence.expected += events_per_px2 * 0.5 * lines[k].length_px * speed * input.duration_s;
    }
  }
  span_s_ += input.duration_s;
}

void TrackHealth::AddEvents(const LineEvents& events, absl::Span<const ImageLine> lines) {
  FindNearest(events, lines);
  const Lanes gate_px = AllLanes(options_.gate_px);
  for (const LineGroup& group : events.groups()) {
    if (!lines[group.line].in_view()) continue;
    const GroupLine line(group, lines[group.line]);
    WindowLine& window_line = window_lines_[places_[group.line].window_line];
    const double begin_px = places_[group.line].begin_px;
    for (size_t i = 0; i < group.events.size(); ++i) {
      const EventLanes& event = group.events[i];
      const Lanes distance_px = line.DistancePx(event);
      const Lanes along_px = line.AlongPx(event);
      const LaneMask is_own = group.is_shared ? is_nearest_[group.first + i] : kAllLanes;
      const LaneMask counts = is_own & line.IsGated(event, distance_px, along_px, gate_px);
      for (int lane = 0; lane < kNumLanes; ++lane) {
        if (counts[lane] == 0) continue;
        AddEvent(distance_px[lane], begin_px + along_px[lane], event.competing[lane], group.polarity, window_line);
      }
    }
  }
}

void TrackHealth::AddEvent(double distance_px, double along_px, double competing, uint8_t polarity, WindowLine& line) {
  LineStatistics& evidence = *line.evidence;
  const double share = OwnShare(distance_px, competing);
  const double place = std::clamp(along_px * line.places_per_px, 0.0, evidence.along.size() - 1.0);
  evidence.along[static_cast<int>(place)] += share;
  line.gated_of[polarity] += share;
  line.near_of[polarity] += std::abs(distance_px) <= options_.near_px ? share : 0.0;
  gated_ += share;
}

void TrackHealth::FindNearest(const LineEvents& events, absl::Span<const ImageLine> lines) {
  constexpr float kBeyond = std::numeric_limits<float>::infinity();
  const Lanes gate_px = AllLanes(options_.gate_px);
  AssignDefaults(events.num_shared_lanes(), events.max_lanes(), distance_px_);
  AssignDefaults(events.num_shared_lanes(), events.max_lanes(), is_nearest_);
  std::fill(distance_px_.begin(), distance_px_.end(), AllLanes(kBeyond));
  for (const LineGroup& group : events.groups()) {
    if (!group.is_shared || !lines[group.line].in_view()) continue;
    const GroupLine line(group, lines[group.line]);
    for (size_t i = 0; i < group.events.size(); ++i) {
      const EventLanes& event = group.events[i];
      const Lanes distance_px = line.DistancePx(event);
      const LaneMask is_gated = line.IsGated(event, distance_px, line.AlongPx(event), gate_px);
      distance_px_[group.first + i] = Select(is_gated, Abs(distance_px), AllLanes(kBeyond));
    }
  }
  for (const LineEvents::Shared& event : events.shared()) {
    float least_px = kBeyond;
    uint32_t nearest = 0;
    for (const uint32_t place : event.Places()) {
      const float distance_px = distance_px_[place / kNumLanes][place % kNumLanes];
      if (distance_px >= least_px) continue;
      least_px = distance_px;
      nearest = place;
    }
    if (least_px < kBeyond) is_nearest_[nearest / kNumLanes][nearest % kNumLanes] = -1;
  }
}

HealthResult TrackHealth::Test(double min_support_ratio, double sure_support_ratio, int min_supported_lines,
                               int64_t patience_us) {
  // Seconds without enough events after which the result is kFewEvents: a pose at rest is reported as such within 20
  // ms.
  constexpr double kLongestSpanS = 0.02;
  // Added to the span because sums of durations in seconds are rounded, and the options are whole microseconds.
  constexpr double kHalfMicrosecond = 0.5;
  const double span_us = span_s_ * 1e6 + kHalfMicrosecond;
  HealthResult result;
  if (gated_ >= options_.min_events && span_us >= static_cast<double>(options_.min_span_us)) {
    result = Evaluate(min_support_ratio, sure_support_ratio, min_supported_lines);
    if (result.kind != HealthResult::Kind::kSupported) {
      if (span_us < static_cast<double>(patience_us)) {
        result.kind = HealthResult::Kind::kOpen;
      } else if (IsQuiet()) {
        result.kind = HealthResult::Kind::kFewEvents;
      }
    }
  } else if (span_s_ >= kLongestSpanS) {
    result.kind = HealthResult::Kind::kFewEvents;
  }
  if (result.kind == HealthResult::Kind::kOpen) return result;
  was_quiet_ = result.kind == HealthResult::Kind::kFewEvents;
  Reset();
  return result;
}

double TrackHealth::CreditedNoiseRatio() const {
  // After kFewEvents the object is at rest, and every background rate explains the events. A moving object does not
  // stop at the moment at which dense noise begins, so that only a limited rate is accepted as an explanation.
  if (was_quiet_) return 1.0;
  double noise = 0.0;
  for (const LineStatistics& line : statistics_) noise += line.noise;
  return noise > 0.0 ? std::min(1.0, options_.max_noise_hz_per_px * gate_px2_s_ / noise) : 1.0;
}

bool TrackHealth::IsQuiet() const {
  double noise = 0.0;
  for (const LineStatistics& line : statistics_) noise += line.noise;
  noise *= CreditedNoiseRatio();
  return gated_ <= noise + options_.significance_sigma * std::sqrt(noise * options_.dispersion);
}

void TrackHealth::AddExcess(double gated, double near, LineStatistics& evidence) const {
  // Gated events outside near_px at which a window has half its weight.
  constexpr double kFewEvents = 4.0;
  const double share = options_.near_px / options_.gate_px;
  const double weight = kFewEvents / (kFewEvents + gated - near);
  evidence.excess += weight * (near - share * gated);
  evidence.variance += weight * weight * gated * share * (1.0 - share);
}

double TrackHealth::ExcessSigma(const LineStatistics& line) const {
  if (line.variance <= 0.0) return 0.0;
  return line.excess / std::sqrt(line.variance * options_.dispersion);
}

bool TrackHealth::IsExpected(const LineStatistics& line, double noise) const {
  const double share = options_.near_px / options_.gate_px;
  const double spread = std::sqrt(noise * share / (1.0 - share) * options_.dispersion);
  return line.expected >= std::max(kTestableEvents, options_.significance_sigma * spread);
}

bool TrackHealth::IsTestable(const LineStatistics& line) const {
  return line.gated - line.noise >= kTestableEvents || IsExpected(line, line.noise);
}

double TrackHealth::PresentRatio(const LineStatistics& line, double noise) const {
  if (IsExpected(line, noise)) return 1.0;
  const auto places = static_cast<double>(line.along.size());
  const double least = (noise + kTestableEvents) / places;
  return static_cast<double>((line.along.array() >= least).count()) / places;
}

HealthResult TrackHealth::Evaluate(double min_support_ratio, double sure_support_ratio, int min_supported_lines) const {
  const double credited_ratio = CreditedNoiseRatio();
  HealthResult result;
  LineStatistics total;
  double supported_length = 0.0, testable_length = 0.0, present_length = 0.0;
  for (size_t k = 0; k < statistics_.size(); ++k) {
    YieldPoint(k);
    LineStatistics line = statistics_[k];
    const double length_px = line.length_px;
    total.Add(line);
    present_length += PresentRatio(line, credited_ratio * line.noise) * length_px;
    if (!IsTestable(line)) line.Add(memory_[k]);
    if (!IsTestable(line)) continue;
    result.testable_lines += line.lines;
    testable_length += length_px;
    if (!(ExcessSigma(line) >= options_.significance_sigma)) continue;
    result.supported_lines += line.lines;
    supported_length += length_px;
  }
  result.sigma = ExcessSigma(total);
  result.present_ratio = total.length_px > 0.0 ? present_length / total.length_px : 0.0;
  result.testable_ratio = total.length_px > 0.0 ? testable_length / total.length_px : 0.0;
  result.support_ratio = testable_length > 0.0 ? supported_length / testable_length : 0.0;
  const bool is_partly_supported = result.sigma > options_.significance_sigma &&
                                   result.support_ratio >= min_support_ratio &&
                                   result.supported_lines >= min_supported_lines;
  if (!is_partly_supported) {
    result.kind = HealthResult::Kind::kUnsupported;
  } else {
    result.kind =
        result.support_ratio >= sure_support_ratio ? HealthResult::Kind::kSupported : HealthResult::Kind::kDoubtful;
  }
  return result;
}

}  // namespace evpose
