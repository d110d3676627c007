// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/event_deficit.h"

#include <algorithm>
#include <cmath>

#include "core/base/yield_point.h"
#include "core/numerics/reusable_vector.h"

namespace evpose {
namespace {

// Pixels per second. Below it the Hessian of the event deficit, which is inversely proportional to the speed, would
// grow without bound, and the counts do not distinguish motion from rest.
constexpr double kMinSpeedPxPerS = 5.0;

// Row vector; its product with the twist is the normal velocity of the middle of one half of a line, px/s.
Vector6d HalfSpeedRow(const CameraModel& camera, const ImageLine& line, int half) {
  return line.jacobian.transpose() * BearingOf(camera, line.PointAt(0.25 + 0.5 * half));
}

}  // namespace

void DeficitCounts::Add(const DeficitCounts& window) {
  for (int half = 0; half < 2; ++half) {
    const double all = expected[half] + window.expected[half];
    const double keep = all > kMemoryEvents ? kMemoryEvents / all : 1.0;
    expected[half] = std::min(all, kMemoryEvents);
    observed[half] = std::clamp(keep * (observed[half] + window.observed[half]), -expected[half], expected[half]);
  }
}

void PoolCounts(absl::Span<DeficitCounts> counts) {
  double expected = 0.0, observed = 0.0;
  for (const DeficitCounts& element : counts) {
    expected += element.expected[0] + element.expected[1];
    observed += element.observed[0] + element.observed[1];
  }
  if (!(expected > 0.0)) return;
  for (DeficitCounts& element : counts) {
    for (int half = 0; half < 2; ++half) element.observed[half] = observed * element.expected[half] / expected;
  }
}

void CountForDeficit(const CameraModel& camera, const WindowInput& input, absl::Span<const ImageLine> lines,
                     absl::Span<const MixtureLine> sums, const Vector6d& twist, double noise_per_px,
                     double min_events_per_px2, std::vector<DeficitCounts>& deficit_counts) {
  AssignDefaults(lines.size(), deficit_counts);
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    if (!lines[k].in_view() || input.ExpectationOf(k) != Expectation::kEvents) continue;
    const double half_px = 0.5 * lines[k].length_px;
    const double events_per_px2 = min_events_per_px2 * lines[k].prior_contrast;
    for (int half = 0; half < 2; ++half) {
      const double speed = std::max(std::abs(HalfSpeedRow(camera, lines[k], half).dot(twist)), kMinSpeedPxPerS);
      deficit_counts[k].expected[half] = events_per_px2 * half_px * speed * input.duration_s;
      const double events = sums[k].half_weight[half][0] * input.sampling.events_per_observation[0] +
                            sums[k].half_weight[half][1] * input.sampling.events_per_observation[1];
      deficit_counts[k].observed[half] = events - noise_per_px * half_px;
    }
  }
  ForEachCurve(input.lines, [&](size_t first, size_t end) {
    if (input.lines[first].is_element) PoolCounts(absl::MakeSpan(deficit_counts).subspan(first, end - first));
  });
}

double AddEventDeficit(const CameraModel& camera, absl::Span<const ImageLine> lines,
                       absl::Span<const DeficitCounts> deficit_counts, absl::Span<const DeficitCounts> past,
                       const Vector6d& twist, double scale, Matrix12d& hessian, Vector12d& gradient) {
  // Missing events of one half line.
  const auto missing_of = [&](size_t k, int half) {
    const DeficitCounts before = past.empty() ? DeficitCounts() : past[k];
    const double observed = std::max(0.0, deficit_counts[k].observed[half] + before.observed[half]);
    const double expected = deficit_counts[k].expected[half];
    return expected * std::max(0.0, 1.0 - observed / (expected + before.expected[half]));
  };
  double all_expected = 0.0;
  double all_missing = 0.0;
  for (size_t k = 0; k < lines.size(); ++k) {
    if (!lines[k].in_view()) continue;
    for (int half = 0; half < 2; ++half) {
      all_expected += deficit_counts[k].expected[half];
      all_missing += missing_of(k, half);
    }
  }
  if (!(all_missing > 0.0)) return 0.0;
  const double deficit_ratio = all_missing / all_expected;
  const double factor = scale * (2.0 * deficit_ratio - 1.0);
  if (factor <= 0.0) return deficit_ratio;
  for (size_t k = 0; k < lines.size(); ++k) {
    YieldPoint(k);
    if (!lines[k].in_view()) continue;
    for (int half = 0; half < 2; ++half) {
      const Vector6d row = HalfSpeedRow(camera, lines[k], half);
      const double velocity = row.dot(twist);
      const double speed = std::max(std::abs(velocity), kMinSpeedPxPerS);
      const double curvature = factor * missing_of(k, half) / (speed * speed);
      hessian.bottomRightCorner<6, 6>() += curvature * row * row.transpose();
      gradient.tail<6>() += curvature * velocity * row;
    }
  }
  return deficit_ratio;
}

}  // namespace evpose
