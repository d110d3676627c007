// SPDX-License-Identifier: Apache-2.0

// The motion of the simulated object: a smooth path on SE(3) that stays in view (core/simulation/README.md, section 1).
#pragma once

#include <array>
#include <cstdint>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

enum class MotionProfile {
  kSmooth,  // always moving
  kRests,   // alternately moves for 0.7 s and rests for 0.3 s, with smooth starts and stops
  kBursts,  // moves for 0.15 s of every second at about four times the speed
  // Moves from one side of the image to the other. The object's origin reaches the image's borders, where half of the
  // object is out of view.
  kHalfOut,
};

// The defaults are assumptions about a table-top scene; the standard scenes replace the speeds. motion_test checks that
// the path has the mean speeds and stays in view.
struct MotionOptions {
  double depth_m = 1.0;             // mean distance from the camera: a table-top scene, the usual use of an EVK4
  double depth_swing_ratio = 0.15;  // the depth stays within depth_m (1 +- this), so that the scale changes visibly
  // Share of the free distance between the object and the image's border that the path uses. Below 1 the object stays
  // in view.
  double extent_ratio = 0.8;
  double rotation_swing_rad = 0.5;       // each component of the rotation vector stays within +- this
  double speed_m_per_s = 0.35;           // mean along the path: about 350 px/s at 1 m with f = 1000 px
  double angular_speed_rad_per_s = 0.8;  // mean; of the order of that of a hand
  MotionProfile profile = MotionProfile::kSmooth;
  // Angle between the optical axis and the centre of the path, to the right: the path is turned about the camera. Only
  // a fisheye lens shows an object at a large angle.
  double view_angle_rad = 0.0;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// camera_from_object as a function of time. Each of the six coordinates is a sum of three sinusoids without a common
// period; their phases follow from the seed. All derivatives are continuous; with kRests and kBursts, only the first
// one is. With kHalfOut, the coordinate across the image is one sine instead, which reaches both borders in every
// period.
class MotionPath {
 public:
  // `radius_m` is the radius of a sphere about the object's origin that contains the object; `view_from_object` is the
  // mean orientation. Errors: INVALID_ARGUMENT naming the field, or stating that the object does not fit into the
  // image.
  static absl::StatusOr<MotionPath> Create(const MotionOptions& options, const CameraModel& camera, double radius_m,
                                           const Eigen::Matrix3d& view_from_object, uint64_t seed);

  // Returns the pose at a time in seconds since the beginning, not negative.
  RigidTransform CameraFromObject(double t_s) const;

 private:
  struct Wave {
    std::array<double, 3> frequency;  // cycles per unit of the path's parameter
    std::array<double, 3> phase_rad;
    double Value(double s) const;  // within [-1, 1]
  };

  Eigen::Vector3d TranslationAt(double s) const;
  Eigen::Vector3d RotationVectorAt(double s) const;
  double ProfileTime(double t_s) const;
  void SetRates(const MotionOptions& options);

  MotionProfile profile_ = MotionProfile::kSmooth;
  Eigen::Matrix3d view_from_object_ = Eigen::Matrix3d::Identity();
  Eigen::Vector3d centre_m_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d swing_m_ = Eigen::Vector3d::Zero();
  double rotation_swing_rad_ = 0.0;
  std::array<Wave, 6> waves_ = {};
  double translation_rate_ = 0.0;  // path parameter per second
  double rotation_rate_ = 0.0;
  Eigen::Matrix3d camera_from_path_ = Eigen::Matrix3d::Identity();
  double border_left_ = 0.0;  // x / z at the left border of the image
  double border_right_ = 0.0;
};

}  // namespace evpose
