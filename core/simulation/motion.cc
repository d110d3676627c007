// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/motion.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/numerics/math.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr double kTwoPi = 2.0 * std::numbers::pi;
// Weights of the three sinusoids of a coordinate. Their sum is 1, so that the coordinate stays within [-1, 1].
constexpr std::array<double, 3> kWeights = {0.55, 0.3, 0.15};

// Returns the mean of |d/ds f(s)| over 40 periods of the slowest sinusoid, in steps of 1/100 of it.
template <typename Function>
double MeanPathSpeed(const Function& f) {
  constexpr int kSteps = 4000;    // 40 periods: the sinusoids have no common period, and the mean depends on the phases
  constexpr double kStep = 0.01;  // 33 steps in a period of the fastest sinusoid
  double length = 0.0;
  Eigen::Vector3d last = f(0.0);
  for (int i = 1; i <= kSteps; ++i) {
    const Eigen::Vector3d next = f(i * kStep);
    length += (next - last).norm();
    last = next;
  }
  return length / (kSteps * kStep);
}

// Returns the integral over [0, t] of a function that rises from 0 to 1 within `ramp` (raised cosine), is constant, and
// falls to 0 until `width`.
double BumpIntegral(double t, double ramp, double width) {
  const auto rise = [ramp](double u) {  // integral of (1 - cos(pi u / ramp)) / 2
    return 0.5 * (u - ramp / std::numbers::pi * DeterministicSinCos(std::numbers::pi * u / ramp).sin);
  };
  if (t <= 0.0) return 0.0;
  if (t <= ramp) return rise(t);
  if (t <= width - ramp) return 0.5 * ramp + (t - ramp);
  if (t >= width) return width - ramp;
  return (width - ramp) - rise(width - t);
}

}  // namespace

absl::Status MotionOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("MotionOptions.depth_m", depth_m, 0.01, 1e4));
  EVPOSE_RETURN_IF_ERROR(CheckRange("MotionOptions.depth_swing_ratio", depth_swing_ratio, 0.0, 0.9));
  EVPOSE_RETURN_IF_ERROR(CheckRange("MotionOptions.extent_ratio", extent_ratio, 0.0, 1.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("MotionOptions.rotation_swing_rad", rotation_swing_rad, 0.0, 1.5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("MotionOptions.speed_m_per_s", speed_m_per_s, 0.0, 1e5));
  EVPOSE_RETURN_IF_ERROR(CheckRange("MotionOptions.angular_speed_rad_per_s", angular_speed_rad_per_s, 0.0, 100.0));
  return CheckRange("MotionOptions.view_angle_rad", view_angle_rad, -1.5, 1.5);
}

double MotionPath::Wave::Value(double s) const {
  double sum = 0.0;
  for (size_t i = 0; i < kWeights.size(); ++i) {
    // Whole cycles are subtracted first, so that the angle stays small in long recordings.
    const double cycles = frequency[i] * s;
    sum += kWeights[i] * DeterministicSinCos(kTwoPi * (cycles - std::floor(cycles)) + phase_rad[i]).sin;
  }
  return sum;
}

absl::StatusOr<MotionPath> MotionPath::Create(const MotionOptions& options, const CameraModel& camera, double radius_m,
                                              const Eigen::Matrix3d& view_from_object, uint64_t seed) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  const double nearest_m = options.depth_m * (1.0 - options.depth_swing_ratio);
  const double half_width_ratio = std::min(camera.cx_px, camera.width_px - 1 - camera.cx_px) / camera.fx_px;
  const double half_height_ratio = std::min(camera.cy_px, camera.height_px - 1 - camera.cy_px) / camera.fy_px;
  // The free distances at the nearest point of the object.
  const double front_m = nearest_m - radius_m;
  const Eigen::Vector2d room_m(half_width_ratio * front_m - radius_m, half_height_ratio * front_m - radius_m);
  if (front_m <= 0.0 || room_m.minCoeff() < 0.0) {
    const double least_m = radius_m * (1.0 + 1.0 / std::min(half_width_ratio, half_height_ratio));
    return absl::InvalidArgumentError(absl::StrFormat(
        "an object of radius %.3g m does not fit in view at %.3g m, the least distance of a motion about %.3g m: give "
        "a distance (depth_m) of more than %.3g m, or a smaller object",
        radius_m, nearest_m, options.depth_m, least_m / (1.0 - options.depth_swing_ratio)));
  }
  MotionPath path;
  path.profile_ = options.profile;
  path.view_from_object_ = view_from_object;
  path.centre_m_ = {0.0, 0.0, options.depth_m};
  path.swing_m_ = {options.extent_ratio * room_m.x(), options.extent_ratio * room_m.y(),
                   options.depth_m * options.depth_swing_ratio};
  path.rotation_swing_rad_ = options.rotation_swing_rad;
  if (options.view_angle_rad != 0.0) path.camera_from_path_ = ExpSo3({0.0, options.view_angle_rad, 0.0});
  path.border_left_ = -camera.cx_px / camera.fx_px;
  path.border_right_ = (camera.width_px - 1 - camera.cx_px) / camera.fx_px;
  Random random(seed);
  // Frequencies without a common period: factors of the coordinates, and of the three sinusoids of one (golden ratio,
  // 1 + sqrt(2)).
  constexpr std::array<double, 6> kAxisFrequency = {1.0, 1.171, 0.837, 1.093, 0.911, 1.257};
  for (size_t axis = 0; axis < path.waves_.size(); ++axis) {
    constexpr std::array<double, 3> kHarmonics = {1.0, 1.618, 2.414};
    for (size_t i = 0; i < kHarmonics.size(); ++i) {
      path.waves_[axis].frequency[i] = kAxisFrequency[axis] * kHarmonics[i];
      path.waves_[axis].phase_rad[i] = random.Uniform(0.0, kTwoPi);
    }
  }
  // The phase is moved near 0 or pi: the path starts near the middle of the image, towards either side.
  if (options.profile == MotionProfile::kHalfOut) {
    double& phase_rad = path.waves_[0].phase_rad[0];
    phase_rad = 0.2 * phase_rad + (phase_rad > std::numbers::pi ? 0.8 * std::numbers::pi : 0.0) - 0.1;
  }
  path.SetRates(options);
  return path;
}

void MotionPath::SetRates(const MotionOptions& options) {
  const double translation_speed = MeanPathSpeed([this](double s) { return TranslationAt(s); });
  const double rotation_speed = MeanPathSpeed([this](double s) { return RotationVectorAt(s); });
  if (translation_speed > 0.0) translation_rate_ = options.speed_m_per_s / translation_speed;
  if (rotation_speed > 0.0) rotation_rate_ = options.angular_speed_rad_per_s / rotation_speed;
}

Eigen::Vector3d MotionPath::TranslationAt(double s) const {
  Eigen::Vector3d translation =
      centre_m_ + swing_m_.cwiseProduct(Eigen::Vector3d(waves_[0].Value(s), waves_[1].Value(s), waves_[2].Value(s)));
  if (profile_ == MotionProfile::kHalfOut) {
    const double cycles = waves_[0].frequency[0] * s;
    const double swing = DeterministicSinCos(kTwoPi * (cycles - std::floor(cycles)) + waves_[0].phase_rad[0]).sin;
    const double x_ratio = border_left_ + 0.5 * (1.0 + swing) * (border_right_ - border_left_);
    translation.x() = x_ratio * translation.z();
  }
  return translation;
}

Eigen::Vector3d MotionPath::RotationVectorAt(double s) const {
  return rotation_swing_rad_ * Eigen::Vector3d(waves_[3].Value(s), waves_[4].Value(s), waves_[5].Value(s));
}

double MotionPath::ProfileTime(double t_s) const {
  if (profile_ == MotionProfile::kSmooth || profile_ == MotionProfile::kHalfOut) return t_s;
  const double whole = std::floor(t_s);
  const double within = t_s - whole;
  constexpr double kRamp = 0.05;  // seconds in which the speed rises or falls: a real object has no jump of it
  if (profile_ == MotionProfile::kRests) {
    constexpr double kMoving = 0.7;  // seconds of motion in every second (MotionProfile::kRests)
    // The speed during the motion is higher, so that the mean over a whole second is that of the options.
    return (whole * (kMoving - kRamp) + BumpIntegral(within, kRamp, kMoving)) / (kMoving - kRamp);
  }
  // MotionProfile::kBursts: begin and duration in every second, and additional speed relative to the mean speed.
  constexpr double kBurstBegin = 0.6;
  constexpr double kBurst = 0.15;
  constexpr double kExtraSpeed = 3.0;
  const double extra_per_second = kExtraSpeed * (kBurst - kRamp);
  return t_s + whole * extra_per_second + kExtraSpeed * BumpIntegral(within - kBurstBegin, kRamp, kBurst);
}

RigidTransform MotionPath::CameraFromObject(double t_s) const {
  const double profile_time = ProfileTime(t_s);
  const RigidTransform pose = {ExpSo3(RotationVectorAt(rotation_rate_ * profile_time)) * view_from_object_,
                               TranslationAt(translation_rate_ * profile_time)};
  if (camera_from_path_.isIdentity(0.0)) return pose;
  return {camera_from_path_ * pose.rotation, camera_from_path_ * pose.translation_m};
}

}  // namespace evpose
