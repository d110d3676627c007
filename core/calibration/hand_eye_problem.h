// SPDX-License-Identifier: Apache-2.0

// The equations of hand-eye calibration (core/calibration/README.md, section 7). Internal to hand_eye.cc.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/calibration/hand_eye.h"

namespace evpose {

inline constexpr int kHandEyeParameters = 13;  // left, right, time offset
using Vector13d = Eigen::Matrix<double, kHandEyeParameters, 1>;
using Matrix13d = Eigen::Matrix<double, kHandEyeParameters, kHandEyeParameters>;

// The motion of the reference G at one time: the pose, inverted for kInHand, and its twist.
struct MovingPose {
  RigidTransform pose;
  Vector6d twist = Vector6d::Zero();
};

// The reference on its own clock; the trajectory must outlive the object.
class MovingReference {
 public:
  MovingReference(const Trajectory& reference, bool is_inverted);
  // nullopt outside the trajectory and in its gaps.
  std::optional<MovingPose> At(int64_t t_us) const;

 private:
  const Trajectory& reference_;
  const bool is_inverted_;
  const int64_t interval_us_;  // median
  const int64_t max_gap_us_;
};

struct HandEyeState {
  RigidTransform left;
  RigidTransform right;
  double time_offset_s = 0.0;

  // Applies steps of `left` and `right` (Perturb()) and of the offset.
  void Step(const Vector13d& step);
};

// A pose of the estimate with the reference at its time.
struct HandEyePair {
  RigidTransform camera_from_object;
  MovingPose reference;
};

// One residual [translation, rotation] with its derivative by the parameters.
struct HandEyeResidual {
  Vector6d value = Vector6d::Zero();
  Eigen::Matrix<double, 6, kHandEyeParameters> jacobian = Eigen::Matrix<double, 6, kHandEyeParameters>::Zero();
};

// Returns the poses that have a reference at their times, in order.
std::vector<HandEyePair> PairPoses(const Trajectory& poses, const MovingReference& reference, double time_offset_s);
HandEyeResidual ResidualOf(const HandEyePair& pair, const HandEyeState& state);

// Start of the iteration: `left` from relative motions, then `right`. The offset of the state is not changed.
void StartHandEye(const std::vector<HandEyePair>& pairs, HandEyeState& state);

// The factor for the translations of the reference with which they fit the poses best: 0.001 for a reference in
// millimetres. nullopt if the poses do not determine it, or if no factor fits.
std::optional<double> ReferenceScale(const std::vector<HandEyePair>& pairs);

}  // namespace evpose
