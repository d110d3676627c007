// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/time_offset.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Bounds the work of the correlation, the product of the numbers of samples: a second.
constexpr double kMaxProducts = 2e8;
// Number of samples of a trajectory; bounds the memory. One time that is far from all others, such as 0 before times
// since 1970, would give a billion.
constexpr double kMaxSamples = 1e6;
constexpr double kMinStepS = 0.005;
// The time within which the motion is measured: long against the noise of single poses, short against the changes of a
// robot's speed.
constexpr double kMinSpanS = 0.1;
// Rotations below this root mean square, radians, within the span are noise: then distances are compared.
constexpr double kMinRotationRad = 0.005;
// Fewer pairs of samples may have a high correlation by chance.
constexpr int64_t kMinPairs = 10;

// Values above this quantile are set to it: jumps between the equivalent poses of a symmetric object are no motion.
constexpr double kCappedQuantile = 0.9;

struct Speeds {
  std::vector<double> rotation_rad;  // NaN in gaps
  std::vector<double> distance_m;
};

void Cap(std::vector<double>& values) {
  std::vector<double> known;
  std::copy_if(values.begin(), values.end(), std::back_inserter(known),
               [](double value) { return !std::isnan(value); });
  if (known.empty()) return;
  const double cap = UpperQuantile(known, kCappedQuantile);
  for (double& value : values) value = value > cap ? cap : value;  // keeps NaN
}

// The motion within `span_us` at every `step_us` from the first pose on.
Speeds SpeedsOf(const Trajectory& trajectory, int64_t step_us, int64_t span_us) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  const int64_t gap_us = std::max(span_us, kGapIntervals * MedianIntervalUs(trajectory));
  Speeds speeds;
  size_t next = 0;  // first pose after the begin of the span
  for (int64_t t_us = trajectory.front().t_us; t_us + span_us <= trajectory.back().t_us; t_us += step_us) {
    while (trajectory[next].t_us <= t_us) ++next;
    bool has_gap = false;
    for (size_t i = next; i < trajectory.size() && trajectory[i - 1].t_us < t_us + span_us; ++i) {
      has_gap |= trajectory[i].t_us - trajectory[i - 1].t_us > gap_us;
    }
    const auto begin = Interpolate(trajectory, t_us);
    const auto end = Interpolate(trajectory, t_us + span_us);
    const bool is_known = !has_gap && begin.ok() && end.ok();
    speeds.rotation_rad.push_back(is_known ? RotationAngle(begin->rotation, end->rotation) : kNone);
    speeds.distance_m.push_back(is_known ? (begin->translation_m - end->translation_m).norm() : kNone);
  }
  Cap(speeds.rotation_rad);
  Cap(speeds.distance_m);
  return speeds;
}

double RootMeanSquare(const std::vector<double>& values) {
  double sum = 0.0;
  int count = 0;
  for (const double value : values) {
    if (std::isnan(value)) continue;
    sum += value * value;
    ++count;
  }
  return count == 0 ? 0.0 : std::sqrt(sum / count);
}

// Pearson's correlation of a[i] and b[i + shift] where both are known; -1 below `min_count` pairs.
double Correlation(const std::vector<double>& a, const std::vector<double>& b, int64_t shift, int64_t min_count) {
  const int64_t begin = std::max<int64_t>(0, -shift);
  const int64_t end = std::min<int64_t>(std::ssize(a), std::ssize(b) - shift);
  double n = 0.0, sum_a = 0.0, sum_b = 0.0, aa = 0.0, bb = 0.0, ab = 0.0;
  for (int64_t i = begin; i < end; ++i) {
    const double x = a[static_cast<size_t>(i)], y = b[static_cast<size_t>(i + shift)];
    if (std::isnan(x) || std::isnan(y)) continue;
    n += 1.0;
    sum_a += x, sum_b += y;
    aa += x * x, bb += y * y, ab += x * y;
  }
  if (n < static_cast<double>(min_count)) return -1.0;
  const double va = aa - sum_a * sum_a / n, vb = bb - sum_b * sum_b / n;
  return va > 0.0 && vb > 0.0 ? (ab - sum_a * sum_b / n) / std::sqrt(va * vb) : -1.0;
}

double Seconds(const Trajectory& trajectory) {
  return static_cast<double>(trajectory.back().t_us - trajectory.front().t_us) * 1e-6;
}

}  // namespace

int64_t MedianIntervalUs(const Trajectory& trajectory) {
  std::vector<int64_t> intervals;
  for (size_t i = 1; i < trajectory.size(); ++i) intervals.push_back(trajectory[i].t_us - trajectory[i - 1].t_us);
  return intervals.empty() ? 0 : UpperMedian(intervals);
}

std::vector<OffsetCandidate> FindTimeOffsets(const Trajectory& estimate, const Trajectory& reference, int max_count) {
  if (estimate.size() < 2 || reference.size() < 2) return {};
  const double longer_s = std::max(Seconds(estimate), Seconds(reference));
  const double step_s =
      std::max({kMinStepS, std::sqrt(Seconds(estimate) * Seconds(reference) / kMaxProducts), longer_s / kMaxSamples});
  const double median_s = 1e-6 * static_cast<double>(std::max(MedianIntervalUs(estimate), MedianIntervalUs(reference)));
  const int64_t step_us = std::llround(step_s * 1e6);
  const int64_t span_us = std::llround(std::max({kMinSpanS, 2.0 * step_s, 2.0 * median_s}) * 1e6);
  const Speeds e = SpeedsOf(estimate, step_us, span_us);
  const Speeds r = SpeedsOf(reference, step_us, span_us);
  const bool turns = std::min(RootMeanSquare(e.rotation_rad), RootMeanSquare(r.rotation_rad)) >= kMinRotationRad;
  const std::vector<double>& a = turns ? e.rotation_rad : e.distance_m;
  const std::vector<double>& b = turns ? r.rotation_rad : r.distance_m;
  const auto is_known = [](double value) { return !std::isnan(value); };
  const int64_t known =
      std::min(std::count_if(a.begin(), a.end(), is_known), std::count_if(b.begin(), b.end(), is_known));
  const int64_t min_count = std::max<int64_t>(kMinPairs, (known + 1) / 2);

  std::vector<double> correlations;
  const int64_t first_shift = -std::ssize(a);
  for (int64_t shift = first_shift; shift < std::ssize(b); ++shift) {
    correlations.push_back(Correlation(a, b, shift, min_count));
  }
  std::vector<OffsetCandidate> candidates;
  const double zero_s = 1e-6 * static_cast<double>(reference.front().t_us - estimate.front().t_us);
  for (size_t i = 0; i < correlations.size(); ++i) {
    const double left = i > 0 ? correlations[i - 1] : -1.0,
                 right = i + 1 < correlations.size() ? correlations[i + 1] : -1.0;
    const double c = correlations[i];
    if (c <= 0.0 || c < left || c <= right) continue;
    // The vertex of the parabola through three samples.
    const double curvature = left - 2.0 * c + right;
    const double vertex = left > -1.0 && right > -1.0 && curvature < 0.0 ? 0.5 * (left - right) / curvature : 0.0;
    const double shift = static_cast<double>(first_shift + static_cast<int64_t>(i)) + vertex;
    candidates.push_back({zero_s + shift * 1e-6 * static_cast<double>(step_us), c});
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const OffsetCandidate& x, const OffsetCandidate& y) { return x.correlation > y.correlation; });
  if (std::ssize(candidates) > max_count) candidates.resize(static_cast<size_t>(max_count));
  return candidates;
}

}  // namespace evpose
