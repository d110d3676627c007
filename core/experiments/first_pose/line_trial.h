// SPDX-License-Identifier: Apache-2.0

// Random trials of the first pose: what a line detector might see of an object, and the truth.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/experiments/first_pose/pose_comparison.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"
#include "core/simulation/scene.h"

namespace evpose {

struct LineTrialOptions {
  SimulatedObject object = SimulatedObject::kCube;
  double noise_px = 0.8;  // standard deviation of each coordinate of an end point, [0, 10]
  int num_spurious = 0;   // segments of nothing, among the object's, [0, 100]
  int num_missing = 0;    // visible lines that were not detected, [0, 20]

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct LineTrial {
  RigidTransform camera_from_object;    // truth
  std::vector<ImageSegment> segments;   // in random order and direction
  std::vector<int> model_line;          // truth: index into ObjectModel::lines for each segment, -1: spurious
  std::vector<VisibleSegment> visible;  // what the camera sees of the object, the missing lines too
};

// Poses are drawn at random: uniform attitudes, 3 to 5 times as far away as the object is long (the standard size of
// SimulationPreset), wherever the whole object is in the image of the simulated EVK4 (without distortion). Of them,
// those are kept in which at least four lines are left when the missing ones are gone, and the visible lines determine
// the pose within what counts as right (PoseDeterminacy, 3 sigma at the trial's noise): a planar target's or a book's
// back, for example, tells nobody which way up it is. No estimator's outcome plays a part, and neither does which
// lines are missing.
//
// A segment is the visible part of a line with Gaussian noise at its end points; parts shorter than 12 px (15 times
// the usual noise) are not found by a detector and left out. A missing line takes all its parts along. Spurious
// segments have the length of one of the object's, and their middle in the object's bounding box, which is grown by a
// fifth; their angle is uniform.
class LineTrialGenerator {
 public:
  // INVALID_ARGUMENT for options, FAILED_PRECONDITION when hardly any pose of the object would do.
  static absl::StatusOr<std::unique_ptr<LineTrialGenerator>> Create(const LineTrialOptions& options);
  virtual ~LineTrialGenerator() = default;

  // The same seed gives the same trial.
  virtual LineTrial Make(uint64_t seed) const = 0;
  virtual const ObjectModel& model() const = 0;  // with its symmetries
  virtual const CameraModel& camera() const = 0;
};

PoseError CompareWithTruth(const LineTrialGenerator& trials, const LineTrial& trial,
                           const RigidTransform& camera_from_object);

}  // namespace evpose
