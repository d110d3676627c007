// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/edge_bias.h"

#include <algorithm>
#include <cmath>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"

namespace evpose {
namespace {

// Sign of the motion, smoothed near zero, where the direction is not known.
double MotionSign(double speed_px_per_s) {
  // Pixels per second at which the sign is 0.7; of the order of the error of the estimated velocity.
  constexpr double kSmoothPxPerS = 15.0;
  return speed_px_per_s / std::sqrt(speed_px_per_s * speed_px_per_s + kSmoothPxPerS * kSmoothPxPerS);
}

}  // namespace

absl::Status EdgeOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckPositive("min_events", min_events));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("memory_events", memory_events));
  return CheckPositive("reversal_memory_px2", reversal_memory_px2);
}

double LiveAreaPx2(const SensorProfile& sensor, double swept_px2, double events, double speed_px_per_s) {
  // Mean slope of a Gaussian step over its levels, relative to its height, per unit of the blur: 1 / (2 sqrt(pi)).
  constexpr double kMeanSlope = 0.28209479177387814;
  // Lower bound of the live share: where pixels miss more, the linear model does not hold.
  constexpr double kMinLiveRatio = 0.25;
  if (sensor.blur_px <= 0.0) return swept_px2;
  const double dead_px2 = events * speed_px_per_s * 1e-6 * sensor.refractory_us * kMeanSlope / sensor.blur_px;
  return std::max(swept_px2 - dead_px2, kMinLiveRatio * swept_px2);
}

EdgeOffsets ExpectedEdgeOffsets(const SensorProfile& sensor, const EdgeRates& rates) {
  const double kappa = std::clamp(rates.kappa, -1.0, 1.0);
  // A stripe has two edges, and each produces half of the events.
  const double edge_share = 0.5 * (1.0 + std::abs(kappa));
  const double thresholds = edge_share * (rates.events_per_px2 + rates.reversals_per_px2);
  const double reversal_ratio = std::min(1.0, edge_share * rates.recent_reversals_per_px2);
  const double contrast = thresholds * sensor.contrast_threshold;
  const double hysteresis = reversal_ratio / std::max(thresholds, reversal_ratio);
  const EdgeResponse& response = EdgeResponse::Get();
  const double on_px = sensor.blur_px * response.MeanOfOnEvents(contrast, hysteresis);
  const double off_px = sensor.blur_px * response.MeanOfOffEvents(contrast, hysteresis);
  // kappa is the share of ON events minus the share of OFF events when the line moves along its normal.
  return {0.5 * ((1.0 + kappa) * on_px + (1.0 - kappa) * off_px),
          -0.5 * ((1.0 - kappa) * on_px + (1.0 + kappa) * off_px)};
}

EdgeOffsets EdgeBias::ExpectedOffsets(const CurveCounts& curve, int half) const {
  if (curve.events < options_.min_events) return {};
  // The lower bounds of the areas avoid a division by zero; min_events need far larger areas.
  const EdgeRates rates = {
      curve.events / std::max(curve.live_px2, 0.25), curve.reversals / std::max(curve.swept_px2, 1.0),
      curve.recent_reversals[half] / std::max(curve.recent_swept_px2[half], 1.0), curve.polarity_motion / curve.events};
  return ExpectedEdgeOffsets(sensor_, rates);
}

void EdgeBias::FindOffsets(absl::Span<const TrackedLine> tracked, std::vector<HalfOffsets>& offsets) const {
  offsets.clear();
  ForEachCurve(tracked, [&](size_t first, size_t end) {
    YieldPoint(first);
    const auto index = static_cast<size_t>(tracked[first].curve);
    HalfOffsets of_curve;
    if (index < curves_.size()) {
      of_curve = {ExpectedOffsets(curves_[index], 0), ExpectedOffsets(curves_[index], 1)};
    }
    for (size_t k = first; k < end; ++k) offsets.push_back(of_curve);
  });
}

void EdgeBias::Correct(absl::Span<const HalfOffsets> offsets, absl::Span<ImageLine> lines) const {
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    ImageLine& line = lines[k];
    if (!line.in_view()) continue;
    // Late time stamps displace the events to an earlier position of the line.
    line.a_expected = line.a - 1e-6 * sensor_.latency_us * line.a_dot;
    const double first = offsets[k][0].At(MotionSign(NormalSpeedPxPerS(camera_, line, 0.25)));
    const double last = offsets[k][1].At(MotionSign(NormalSpeedPxPerS(camera_, line, 0.75)));
    // The correction is linear along the line and therefore linear in the bearing: offset = at_begin + slope * along.
    const Eigen::Vector2d focal(camera_.fx_px, camera_.fy_px);
    const Eigen::Vector2d centre(camera_.cx_px, camera_.cy_px);
    const double at_begin = 1.5 * first - 0.5 * last;
    const double slope = 2.0 * (last - first) / line.length_px;
    const Eigen::Vector2d along = slope * line.direction;
    Eigen::Vector3d offset;
    offset.head<2>() = along.cwiseProduct(focal);
    offset.z() = at_begin + along.dot(centre - line.p1_px);
    line.a_expected -= offset;
  }
}

void EdgeBias::Learn(absl::Span<const TrackedLine> tracked, absl::Span<const ImageLine> lines,
                     absl::Span<const EdgeCounts> counts, double duration_s) {
  // Pixels per second. Slower lines produce too few events compared with noise, and their direction may be wrong.
  constexpr double kMinSpeedPxPerS = 20.0;
  constexpr double kMinLengthPx = 10.0;  // the events at the ends of a shorter line dominate its counts
  ForEachCurve(tracked, [&](size_t begin, size_t end) {
    // The ends of an element at which another one continues are no ends of the curve.
    double length_px = 0.0;
    for (size_t k = begin; k < end; ++k) length_px += lines[k].length_px;
    if (length_px < kMinLengthPx) return;
    for (size_t k = begin; k < end; ++k) {
      const ImageLine& line = lines[k];
      if (!line.in_view()) continue;
      // Not the ends themselves: a pivot in the outer tenths reverses the motion of few events.
      const double first = NormalSpeedPxPerS(camera_, line, 0.1);
      const double last = NormalSpeedPxPerS(camera_, line, 0.9);
      if (first * last < 0.0 || std::min(std::abs(first), std::abs(last)) < kMinSpeedPxPerS) continue;
      const size_t index = static_cast<size_t>(tracked[k].curve);
      if (index >= curves_.size()) curves_.resize(index + 1);
      const double half_px_s = 0.5 * line.length_px * duration_s;
      const std::array<double, 2> swept_px2 = {half_px_s * std::abs(NormalSpeedPxPerS(camera_, line, 0.25)),
                                               half_px_s * std::abs(NormalSpeedPxPerS(camera_, line, 0.75))};
      Add(counts[k], 0.5 * (first + last), swept_px2, curves_[index]);
    }
  });
}

void EdgeBias::Add(const EdgeCounts& counts, double velocity_px_per_s, const std::array<double, 2>& swept_px2,
                   CurveCounts& curve) const {
  const double direction = velocity_px_per_s > 0.0 ? 1.0 : -1.0;
  const double events = counts.polarity[0] + counts.polarity[1];
  const double both_px2 = swept_px2[0] + swept_px2[1];
  curve.events += events;
  curve.swept_px2 += both_px2;
  curve.live_px2 += LiveAreaPx2(sensor_, both_px2, events, std::abs(velocity_px_per_s));
  curve.polarity_motion += direction * (counts.polarity[1] - counts.polarity[0]);
  curve.reversals += counts.reversals[0] + counts.reversals[1];
  const double keep = std::min(1.0, options_.memory_events / std::max(curve.events, 1.0));
  curve.events *= keep;
  curve.swept_px2 *= keep;
  curve.live_px2 *= keep;
  curve.polarity_motion *= keep;
  curve.reversals *= keep;
  for (int half = 0; half < 2; ++half) {
    curve.recent_reversals[half] += counts.reversals[half];
    curve.recent_swept_px2[half] += swept_px2[half];
    const double keep_recent =
        std::min(1.0, options_.reversal_memory_px2 / std::max(curve.recent_swept_px2[half], 1.0));
    curve.recent_reversals[half] *= keep_recent;
    curve.recent_swept_px2[half] *= keep_recent;
  }
}

}  // namespace evpose
