// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/health.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/association/line_cells.h"
#include "core/association/other_objects.h"
#include "core/base/yield_point.h"
#include "core/numerics/reusable_vector.h"

namespace evpose {
namespace {

// Events that a testable line needs. If all of them are near an isolated line, z of equation (2) is 3.5; with fewer
// than 17 it cannot reach significance_sigma.
constexpr double kTestableEvents = 20.0;

// The octant of a direction in the image, 0 to 7.
int OctantOf(const Eigen::Vector2d& direction) {
  const bool is_steep = std::abs(direction.y()) > std::abs(direction.x());
  return (direction.x() < 0.0 ? 1 : 0) + (direction.y() < 0.0 ? 2 : 0) + (is_steep ? 4 : 0);
}

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

TrackHealth::TrackHealth(const HealthOptions& options, const NearProbability& near_probability,
                         double min_events_per_px2, int num_curves)
    : options_(options),
      near_probability_(near_probability),
      min_events_per_px2_(min_events_per_px2),
      statistics_(static_cast<size_t>(num_curves)),
      memory_(static_cast<size_t>(num_curves)),
      curve_results_(static_cast<size_t>(num_curves)) {
  const CellTerms widest = near_probability.Of(options.gate_px, NearProbability::kSpreadSteps);
  testable_information_ = kTestableEvents * widest.Information();
}

void TrackHealth::Reset() {
  const double left = std::max(0.0, 1.0 - span_s_ * 1e6 / static_cast<double>(options_.memory_us));
  for (size_t k = 0; k < statistics_.size(); ++k) memory_[k].Add(statistics_[k], left);
  std::fill(statistics_.begin(), statistics_.end(), LineStatistics());
  span_s_ = 0.0;
  gated_ = 0.0;
  gate_px2_s_ = 0.0;
  recent_ = Recent();
}

void TrackHealth::EnterLines(const WindowInput& input, absl::Span<const ImageLine> lines) {
  window_lines_.clear();
  places_.clear();
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double all_px = 0.0;
  for (const ImageLine& line : lines) {
    if (!line.in_view()) continue;
    centre += line.length_px * line.PointAt(0.5);
    all_px += line.length_px;
  }
  centre /= std::max(all_px, 1.0);
  ForEachCurve(input.lines, [&](size_t first, size_t end) {
    double length_px = 0.0;
    for (size_t k = first; k < end; ++k) {
      const std::array<int, 2> sectors = {OctantOf(lines[k].PointAt(0.25) - centre),
                                          OctantOf(lines[k].PointAt(0.75) - centre)};
      places_.push_back({window_lines_.size(), length_px, sectors});
      length_px += lines[k].length_px;
    }
    WindowLine& line = window_lines_.emplace_back();
    line.curve = input.lines[first].curve;
    line.bins_per_px = static_cast<double>(line.along.size()) / length_px;
    if (!input.lines[first].is_element) return;
    line.lines = NumLines(input.lines.subspan(first, end - first), lines.subspan(first, end - first), length_px);
  });
}

void TrackHealth::CountWindow(const WindowInput& input, absl::Span<const ImageLine> lines, const WindowFit& fit) {
  const int spread_step = near_probability_.SpreadStepOf(fit.residual_rms_px);
  const CellTerms whole_gate = near_probability_.Of(options_.gate_px, spread_step);
  EnterLines(input, lines);
  window_sectors_ = {};
  FindNearest(*input.sorted, lines);
  const Lanes gate_px = AllLanes(options_.gate_px);
  for (const LineGroup& group : input.sorted->groups()) {
    if (!lines[group.line].in_view()) continue;
    const GroupLine line(group, lines[group.line]);
    const Place& place = places_[group.line];
    if (!group.is_shared && !input.sorted->has_others()) {
      AddOwnEvents(group, line, place, whole_gate);
      continue;
    }
    for (size_t i = 0; i < group.events.size(); ++i) {
      const EventLanes& event = group.events[i];
      const Lanes distance_px = line.DistancePx(event);
      const Lanes along_px = line.AlongPx(event);
      const LaneMask is_own = group.is_shared ? is_nearest_[group.first + i] : kAllLanes;
      const LaneMask counts = is_own & line.IsGated(event, distance_px, along_px, gate_px);
      for (int lane = 0; lane < kNumLanes; ++lane) {
        if (counts[lane] == 0) continue;
        const CellTerms cell =
            group.is_shared ? near_probability_.Of(half_cell_px_[group.first + i][lane], spread_step) : whole_gate;
        const size_t half = 2.0 * along_px[lane] < lines[group.line].length_px ? 0 : 1;
        AddEvent({distance_px[lane], place.begin_px + along_px[lane], event.others_per_px[lane], group.polarity}, cell,
                 window_lines_[place.window_line], window_sectors_[place.sector[half]]);
      }
    }
  }
}

void TrackHealth::AddOwnEvents(const LineGroup& group, const GroupLine& line, const Place& place,
                               const CellTerms& cell) {
  WindowLine& window_line = window_lines_[place.window_line];
  const Lanes gate_px = AllLanes(options_.gate_px), near_px = AllLanes(cell.near_px);
  const Lanes begin = AllLanes(place.begin_px * window_line.bins_per_px);
  const Lanes bins_per_px = AllLanes(window_line.bins_per_px);
  const Lanes last_bin = AllLanes(static_cast<double>(window_line.along.size()) - 1.0);
  std::array<LaneMask, 2> gated = {}, near = {};  // by half of the line, minus the counts: a mask is -1
  for (const EventLanes& event : group.events) {
    const Lanes distance_px = line.DistancePx(event);
    const Lanes along_px = line.AlongPx(event);
    const LaneMask counts = line.IsGated(event, distance_px, along_px, gate_px);
    const LaneMask is_near = counts & (Abs(distance_px) <= near_px);
    const LaneMask is_second = 2.0f * along_px >= line.length_px();
    gated[0] += counts & ~is_second;
    gated[1] += counts & is_second;
    near[0] += is_near & ~is_second;
    near[1] += is_near & is_second;
    const Lanes along = begin + along_px * bins_per_px;
    const Lanes bins = Select(along > 0.0f, Select(along < last_bin, along, last_bin), Lanes{});
    for (int i = 0; i < kNumLanes; ++i) window_line.along[static_cast<int>(bins[i])] -= counts[i];
  }
  const auto count = [](LaneMask mask) { return static_cast<double>(-(mask[0] + mask[1] + mask[2] + mask[3])); };
  for (int half = 0; half < 2; ++half) {
    window_line.by_polarity[group.polarity].Add(count(gated[half]), count(near[half]), cell);
    window_sectors_[place.sector[half]].Add(count(gated[half]), count(near[half]), cell);
  }
}

void TrackHealth::AddEvent(const NearEvent& event, const CellTerms& cell, WindowLine& line, Sector& sector) {
  const double share = OwnShare(event.distance_px, event.others_per_px);
  const double near = std::abs(event.distance_px) <= cell.near_px ? share : 0.0;
  const double bin = std::clamp(event.along_px * line.bins_per_px, 0.0, line.along.size() - 1.0);
  line.along[static_cast<int>(bin)] += share;
  line.by_polarity[event.polarity].Add(share, near, cell);
  sector.Add(share, near, cell);
}

void TrackHealth::PolarityCounts::Add(double new_gated, double new_near, const CellTerms& cell) {
  gated += new_gated;
  near += new_near;
  excess += new_near - new_gated * cell.chance;
  variance += new_gated * cell.Variance();
  right_excess += new_gated * cell.right_excess;
  information += new_gated * cell.Information();
}

void TrackHealth::Sector::Add(double gated, double near, const CellTerms& cell) {
  // Excess of the right pose per event below which an event carries no evidence: the cell is narrower than the spread.
  constexpr double kLeastExcess = 0.1;
  if (cell.right_excess < kLeastExcess) return;
  observed += (near - gated * cell.chance) / cell.right_excess;
  variance += gated * cell.Variance() / (cell.right_excess * cell.right_excess);
}

EventConcentration TrackHealth::Concentration(const WindowInput& input, absl::Span<const ImageLine> lines,
                                              const WindowFit& fit) {
  CountWindow(input, lines, fit);
  LineStatistics total;
  for (const WindowLine& line : window_lines_) {
    for (const PolarityCounts& counts : line.by_polarity) AddExcess(counts, total);
  }
  return {ExcessSigma(total), total.right_excess > 0.0 ? total.excess / total.right_excess : 0.0};
}

void TrackHealth::AddWindow(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                            const WindowFit& fit) {
  CountWindow(input, lines, fit);
  for (const WindowLine& line : window_lines_) {
    LineStatistics& statistics = statistics_[line.curve];
    statistics.lines = std::max(statistics.lines, line.lines);
    statistics.along += line.along;
    for (int polarity = 0; polarity < 2; ++polarity) {
      statistics.gated += input.sampling.polarity_weight[polarity] * line.by_polarity[polarity].gated;
      statistics.information += input.sampling.polarity_weight[polarity] * line.by_polarity[polarity].information;
      AddExcess(line.by_polarity[polarity], statistics);
      gated_ += line.by_polarity[polarity].gated;
      recent_.gated += line.by_polarity[polarity].gated;
    }
  }
  const double observed_ratio = input.sampling.observations_per_background_event;
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    if (!lines[k].in_view()) continue;
    const double gate_px2 = GateAreaPx2(input.cells, lines, k, options_.gate_px) * observed_ratio;
    gate_px2_s_ += gate_px2 * input.duration_s;
    LineStatistics& statistics = statistics_[input.lines[k].curve];
    statistics.noise += input.background_per_px2 * gate_px2;
    recent_.noise += input.background_per_px2 * gate_px2;
    statistics.length_px += lines[k].length_px * input.duration_s;
  }
  AddExpectedEvents(camera, input, lines, fit.state.twist);
  contrast_.Add(fit, 1.0 - input.duration_s * 1e6 / static_cast<double>(options_.contrast_memory_us));
  span_s_ += input.duration_s;
  recent_.span_s += input.duration_s;
}

void TrackHealth::AddExpectedEvents(const CameraModel& camera, const WindowInput& input,
                                    absl::Span<const ImageLine> lines, const Vector6d& twist) {
  // Expected events of a sector that are remembered: four times as many as make the absence of all of them significant.
  constexpr double kSectorEvents = 200.0;
  for (size_t k = 0; k < lines.size(); ++k) {
    const Expectation expectation = input.ExpectationOf(k);
    if (!lines[k].in_view() || expectation == Expectation::kNothing) continue;
    const double events_per_px2 = min_events_per_px2_ * lines[k].prior_contrast;
    for (int half = 0; half < 2; ++half) {
      const Eigen::Vector3d bearing = BearingOf(camera, lines[k].PointAt(0.25 + 0.5 * half));
      const double speed = std::abs(bearing.dot(lines[k].jacobian * twist));
      const double expected = events_per_px2 * 0.5 * lines[k].length_px * speed * input.duration_s;
      statistics_[input.lines[k].curve].expected += expected;
      if (expectation == Expectation::kEvents) window_sectors_[places_[k].sector[half]].expected += expected;
    }
  }
  const double events_per_observation = input.sampling.mean_events_per_observation;
  for (int i = 0; i < kNumOutlineSectors; ++i) {
    Sector& sector = sectors_[i];
    sector.expected += window_sectors_[i].expected;
    sector.observed += events_per_observation * window_sectors_[i].observed;
    sector.variance += events_per_observation * events_per_observation * window_sectors_[i].variance;
    const double kept = std::min(1.0, kSectorEvents / std::max(sector.expected, 1.0));
    sector.expected *= kept;
    sector.observed *= kept;
    sector.variance *= kept;
  }
}

bool TrackHealth::Sector::IsMissing(const HealthOptions& options) const {
  const double missing = expected - std::max(0.0, observed);
  return missing > 0.5 * expected &&
         missing > options.significance_sigma * std::sqrt(options.dispersion * (expected + variance));
}

int TrackHealth::MissingSectors() const {
  return static_cast<int>(
      std::count_if(sectors_.begin(), sectors_.end(), [this](const Sector& s) { return s.IsMissing(options_); }));
}

void TrackHealth::FindNearest(const LineEvents& events, absl::Span<const ImageLine> lines) {
  constexpr float kBeyond = std::numeric_limits<float>::infinity();
  // A line at up to this distance may limit the cell of a nearer one within the gate.
  const Lanes gate_px = AllLanes(2.0 * options_.gate_px);
  ResizeUnset(events.num_shared_lanes(), events.max_lanes(), distance_px_);
  ResizeUnset(events.num_shared_lanes(), events.max_lanes(), half_cell_px_);  // set for the nearest lines
  AssignDefaults(events.num_shared_lanes(), events.max_lanes(), is_nearest_);
  ResizeUnset(events.num_shared_lanes(), events.max_lanes(), line_of_);  // set for the lines in view
  std::fill(distance_px_.begin(), distance_px_.end(), AllLanes(kBeyond));
  for (const LineGroup& group : events.groups()) {
    if (!group.is_shared || !lines[group.line].in_view()) continue;
    const GroupLine line(group, lines[group.line]);
    for (size_t i = 0; i < group.events.size(); ++i) {
      const EventLanes& event = group.events[i];
      const Lanes distance_px = line.DistancePx(event);
      const LaneMask is_gated = line.IsGated(event, distance_px, line.AlongPx(event), gate_px);
      distance_px_[group.first + i] = Select(is_gated, distance_px, AllLanes(kBeyond));
      line_of_[group.first + i] = group.line;
    }
  }
  const auto distance_at = [this](uint32_t place) { return distance_px_[place / kNumLanes][place % kNumLanes]; };
  for (const LineEvents::Shared& event : events.shared()) {
    float least_px = kBeyond;
    uint32_t nearest = 0;
    for (const uint32_t place : event.Places()) {
      const float distance_px = std::abs(distance_at(place));
      if (distance_px >= least_px) continue;
      least_px = distance_px;
      nearest = place;
    }
    if (!(least_px <= options_.gate_px)) continue;
    const Eigen::Vector2d& direction = lines[line_of_[nearest / kNumLanes]].direction;
    const double side = distance_at(nearest) < 0.0f ? -1.0 : 1.0;
    double half_cell_px = options_.gate_px;
    for (const uint32_t place : event.Places()) {
      const float distance_px = distance_at(place);
      if (place == nearest || !(std::abs(distance_px) < kBeyond)) continue;
      const double cosine = side * direction.dot(lines[line_of_[place / kNumLanes]].direction);
      half_cell_px = std::min(half_cell_px, CellBoundaryPx(least_px, distance_px, cosine));
    }
    is_nearest_[nearest / kNumLanes][nearest % kNumLanes] = -1;
    half_cell_px_[nearest / kNumLanes][nearest % kNumLanes] =
        static_cast<float>(std::max<double>(half_cell_px, least_px));
  }
}

HealthResult TrackHealth::Test(const TestThresholds& thresholds) {
  // Seconds without more events than those of the background after which the result is kFewEvents: a pose at rest is
  // reported as such within 20 ms.
  constexpr double kLongestSpanS = 0.02;
  // Seconds after which a test without power ends as kFewEvents, because the last support is then too old.
  constexpr double kLongestOpenS = 1.0;
  // Added to the span because sums of durations in seconds are rounded, and the options are whole microseconds.
  constexpr double kHalfMicrosecond = 0.5;
  const double span_us = span_s_ * 1e6 + kHalfMicrosecond;
  HealthResult result;
  if (gated_ >= options_.min_events && span_us >= static_cast<double>(options_.min_span_us)) {
    result = Evaluate(thresholds);
    if (result.kind != HealthResult::Kind::kSupported) {
      if (span_us < static_cast<double>(thresholds.min_contradiction_us)) {
        result.kind = HealthResult::Kind::kOpen;
      } else if (IsExplained(gated_, Noise())) {
        result.kind = HealthResult::Kind::kFewEvents;
      }
    }
  }
  if (result.kind == HealthResult::Kind::kOpen && recent_.span_s >= kLongestSpanS) {
    const bool is_quiet = IsExplained(recent_.gated, AcceptedNoiseRatio() * recent_.noise);
    if (is_quiet || span_s_ >= kLongestOpenS) result.kind = HealthResult::Kind::kFewEvents;
    recent_ = Recent();
  }
  if (result.kind == HealthResult::Kind::kOpen) return result;
  had_few_events_ = result.kind == HealthResult::Kind::kFewEvents;
  Reset();
  return result;
}

double TrackHealth::Noise() const {
  double noise = 0.0;
  for (const LineStatistics& line : statistics_) noise += line.noise;
  return noise * AcceptedNoiseRatio();
}

double TrackHealth::AcceptedNoiseRatio() const {
  // After kFewEvents the object is at rest, and every background rate explains the events. A moving object does not
  // stop at the moment at which dense noise begins, so that only a limited rate is accepted as an explanation.
  if (had_few_events_) return 1.0;
  double noise = 0.0;
  for (const LineStatistics& line : statistics_) noise += line.noise;
  return noise > 0.0 ? std::min(1.0, options_.max_noise_hz_per_px * gate_px2_s_ / noise) : 1.0;
}

bool TrackHealth::IsExplained(double gated, double noise) const {
  // One event more than the noise is no significant excess, however little noise there is.
  return gated <= noise + options_.significance_sigma * std::sqrt(std::max(noise, 1.0) * options_.dispersion);
}

void TrackHealth::AddExcess(const PolarityCounts& counts, LineStatistics& statistics) {
  // Gated events outside near_px at which a window has half its weight.
  constexpr double kFewEvents = 4.0;
  const double weight = kFewEvents / (kFewEvents + counts.gated - counts.near);
  statistics.excess += weight * counts.excess;
  statistics.variance += weight * weight * counts.variance;
  statistics.right_excess += weight * counts.right_excess;
}

double TrackHealth::ExcessSigma(const LineStatistics& line) const {
  if (line.variance <= 0.0) return 0.0;
  return line.excess / std::sqrt(line.variance * options_.dispersion);
}

double TrackHealth::RightExcess(const LineStatistics& line, double accepted_noise_ratio) {
  const double noise = accepted_noise_ratio * line.noise;
  return line.right_excess * (line.gated > 0.0 ? std::max(0.0, 1.0 - noise / line.gated) : 0.0);
}

double TrackHealth::PowerSigma(const LineStatistics& line, double accepted_noise_ratio) const {
  if (line.variance <= 0.0) return 0.0;
  return RightExcess(line, accepted_noise_ratio) / std::sqrt(line.variance * options_.dispersion);
}

bool TrackHealth::IsExpected(const LineStatistics& line, double noise, double events) const {
  const double share = options_.near_px / options_.gate_px;
  const double spread = std::sqrt(noise * share / (1.0 - share) * options_.dispersion);
  return line.expected >= std::max(events, options_.significance_sigma * spread);
}

bool TrackHealth::IsTestable(const LineStatistics& line) const {
  const double signal = line.gated - line.noise;
  const bool has_events = signal >= kTestableEvents && line.information * signal / line.gated >= testable_information_;
  return has_events || IsExpected(line, line.noise, kTestableEvents);
}

bool TrackHealth::HasPower(const LineStatistics& line, double accepted_noise_ratio) const {
  // The number of events, and with it the square of the power, is that of IsTestable().
  const double ratio = options_.power_sigma / options_.significance_sigma;
  return PowerSigma(line, accepted_noise_ratio) >= options_.power_sigma ||
         IsExpected(line, line.noise, ratio * ratio * kTestableEvents);
}

double TrackHealth::PresentRatio(const LineStatistics& line, double noise) const {
  return IsExpected(line, noise, kTestableEvents) ? 1.0 : PresentBins(line, noise);
}

double TrackHealth::PresentBins(const LineStatistics& line, double noise) {
  const auto num_bins = static_cast<double>(line.along.size());
  const double least = (noise + kTestableEvents) / num_bins;
  return static_cast<double>((line.along.array() >= least).count()) / num_bins;
}

bool TrackHealth::IsDisplaced(size_t curve, double accepted_noise_ratio) const {
  LineStatistics line = statistics_[curve];
  line.Add(memory_[curve]);
  return ExcessSigma(line) < options_.significance_sigma &&
         PowerSigma(line, accepted_noise_ratio) >= options_.power_sigma &&
         PresentBins(line, accepted_noise_ratio * line.noise) >= 0.5;
}

double TrackHealth::PooledShare(const LineStatistics& pooled, double accepted_noise_ratio) const {
  const bool is_significant = ExcessSigma(pooled) >= options_.significance_sigma;
  return is_significant ? pooled.excess / std::max(pooled.excess, RightExcess(pooled, accepted_noise_ratio)) : 0.0;
}

void TrackHealth::AddCurve(size_t k, double accepted_noise_ratio, CurveSums& sums) {
  CurveResult& curve = curve_results_[k];
  curve = {CurveResult::Kind::kOpen, std::max(0.0, statistics_[k].excess + memory_[k].excess),
           statistics_[k].expected + memory_[k].expected};
  LineStatistics line = statistics_[k];
  const double length_px = line.length_px;
  sums.total.Add(line);
  sums.present_length += PresentRatio(line, accepted_noise_ratio * line.noise) * length_px;
  if (!IsTestable(line)) line.Add(memory_[k]);
  if (!IsTestable(line)) return;
  sums.testable_lines += line.lines;
  sums.testable_length += length_px;
  if (ExcessSigma(line) >= options_.significance_sigma) {
    sums.supported_lines += line.lines;
    sums.decided_lines += line.lines;
    sums.supported_length += length_px;
    curve.kind = CurveResult::Kind::kSupported;
    curve.support_ratio = 1.0;
    return;
  }
  if (HasPower(line, accepted_noise_ratio)) {
    sums.decided_lines += line.lines;
    sums.contradicting_length += length_px;
    curve.kind = CurveResult::Kind::kContradicted;
  } else {
    curve.kind = CurveResult::Kind::kPooled;
    sums.pooled.Add(line);
    sums.pooled_length += length_px;
    sums.pooled_lines += line.lines;
  }
  if (IsDisplaced(k, accepted_noise_ratio)) sums.displaced_length += length_px;
}

HealthResult TrackHealth::Evaluate(const TestThresholds& thresholds) {
  using Kind = HealthResult::Kind;
  const double accepted_noise_ratio = AcceptedNoiseRatio();
  CurveSums sums;
  for (size_t k = 0; k < statistics_.size(); ++k) {
    YieldPoint(k);
    AddCurve(k, accepted_noise_ratio, sums);
  }
  const double pooled_share = PooledShare(sums.pooled, accepted_noise_ratio);
  sums.supported_length += pooled_share * sums.pooled_length;
  // While enough lines are supported by tests of their own, only these determine the motions.
  const bool are_pooled_needed = sums.supported_lines < options_.confirm_lines;
  if (are_pooled_needed && pooled_share >= options_.confirm_support_ratio) {
    for (CurveResult& curve : curve_results_) {
      if (curve.kind == CurveResult::Kind::kPooled) curve.support_ratio = pooled_share;
    }
  }
  const double decided_length = sums.supported_length + sums.contradicting_length;
  const double decided_ratio = decided_length > 0.0 ? sums.supported_length / decided_length : 0.0;
  const double length_px = sums.total.length_px;
  HealthResult result;
  result.supported_lines = sums.supported_lines + static_cast<int>(pooled_share * sums.pooled_lines);
  result.testable_lines = sums.testable_lines;
  result.sigma = ExcessSigma(sums.total);
  result.present_ratio = length_px > 0.0 ? sums.present_length / length_px : 0.0;
  result.testable_ratio = length_px > 0.0 ? sums.testable_length / length_px : 0.0;
  result.support_ratio = sums.testable_length > 0.0 ? sums.supported_length / sums.testable_length : 0.0;
  result.missing_sectors = MissingSectors();
  const bool has_excess =
      result.sigma > options_.significance_sigma &&
      sums.total.excess >= options_.min_excess_ratio * RightExcess(sums.total, accepted_noise_ratio);
  const bool has_lines = result.supported_lines >= thresholds.min_lines;
  if (!has_excess) {
    result.kind = HasPower(sums.total, accepted_noise_ratio) ? Kind::kUnsupported : Kind::kOpen;
  } else if (has_lines && result.support_ratio >= options_.confirm_support_ratio) {
    const bool is_doubtful = IsAttractedByClutter() || result.missing_sectors > options_.max_missing_sectors ||
                             sums.displaced_length > options_.max_displaced_ratio * sums.testable_length;
    result.kind = is_doubtful ? Kind::kDoubtful : Kind::kSupported;
  } else if (has_lines && result.support_ratio >= thresholds.keep_support_ratio) {
    result.kind = decided_ratio < options_.confirm_support_ratio ? Kind::kDoubtful : Kind::kOpen;
  } else if (sums.decided_lines >= thresholds.min_lines &&
             (!has_lines || decided_ratio < thresholds.keep_support_ratio)) {
    result.kind = Kind::kUnsupported;
  }
  return result;
}

}  // namespace evpose
