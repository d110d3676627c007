// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/trajectory_gaps.h"

#include <algorithm>
#include <limits>
#include <vector>

#include "core/numerics/statistics.h"

namespace evpose {
namespace {

constexpr int64_t kMinLongestStepUs = 50'000;
constexpr int64_t kMedianSteps = 3;  // a file may lack single poses
constexpr int64_t kMaxInterpolatedStepUs = 500'000;

}  // namespace

int64_t LongestStepUs(const Trajectory& trajectory) {
  std::vector<int64_t> steps_us;
  for (size_t i = 1; i < trajectory.size(); ++i) steps_us.push_back(trajectory[i].t_us - trajectory[i - 1].t_us);
  if (steps_us.empty()) return kMinLongestStepUs;
  const int64_t median_us = std::min(UpperMedian(steps_us), std::numeric_limits<int64_t>::max() / kMedianSteps);
  return std::max(kMinLongestStepUs, kMedianSteps * median_us);
}

int64_t LongestInterpolatedStepUs(const Trajectory& trajectory) {
  return std::min(LongestStepUs(trajectory), kMaxInterpolatedStepUs);
}

std::optional<RigidTransform> PoseNear(const Trajectory& trajectory, int64_t t_us, int64_t max_gap_us,
                                       absl::Span<const size_t> breaks) {
  const auto after = std::lower_bound(trajectory.begin(), trajectory.end(), t_us,
                                      [](const StampedPose& pose, int64_t t) { return pose.t_us < t; });
  const bool is_between = after != trajectory.begin() && after != trajectory.end() && after->t_us != t_us;
  const auto index = static_cast<size_t>(after - trajectory.begin());
  if (is_between && std::binary_search(breaks.begin(), breaks.end(), index)) return std::nullopt;
  return PoseNear(trajectory, t_us, max_gap_us);
}

}  // namespace evpose
