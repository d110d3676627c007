// SPDX-License-Identifier: Apache-2.0

// Random trials for first poses: possible output of a line detector, and the truth.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/experiments/first_pose/pose_comparison.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"
#include "core/simulation/scene.h"

namespace evpose {

// The defaults are settings of the benchmark and not tuned. The noise is that of the events of a default sensor
// (SensorProfile::pixel_noise_px).
struct LineTrialOptions {
  SimulatedObject object = SimulatedObject::kCube;
  double noise_px = 0.8;  // standard deviation of each coordinate of an end point, [0, 10]
  int num_spurious = 0;   // spurious segments, [0, 100]
  int num_missing = 0;    // visible lines without a segment, [0, 20]

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

struct LineTrial {
  RigidTransform camera_from_object;    // truth
  std::vector<ImageSegment> segments;   // in random order and direction
  std::vector<int> model_line;          // index into ObjectModel::lines of each segment; -1: spurious
  std::vector<VisibleSegment> visible;  // visible parts of the object, including the missing lines
};

// Generates trials.
//
// Poses are random: uniform rotations at 3 to 5 times the length of the object (the standard size of SimulationPreset),
// at positions where the whole object is in the image of the simulated EVK4 (without distortion). A pose is used if at
// least four lines remain without the missing ones, and if the visible lines determine the pose within the tolerance of
// a right pose (PoseDeterminacy, 3 sigma at the noise of the trial). The back of a planar target or of a book, for
// example, does not determine which side is up. The choice depends neither on the result of an estimator nor on which
// lines are missing.
//
// A segment is the visible part of a line with Gaussian noise at its end points; parts shorter than 12 px (15 times the
// usual noise) are removed, because a detector does not find them. A missing line has no segment for any of its parts.
// A spurious segment has the length of a segment of the object, its middle in the bounding box of the object enlarged
// by a fifth, and a uniform direction.
class LineTrialGenerator {
 public:
  // INVALID_ARGUMENT for the options; FAILED_PRECONDITION if hardly any pose of the object is suitable.
  static absl::StatusOr<std::unique_ptr<LineTrialGenerator>> Create(const LineTrialOptions& options);
  virtual ~LineTrialGenerator() = default;

  // Equal seeds give equal trials.
  virtual LineTrial Make(uint64_t seed) const = 0;
  virtual const ObjectModel& model() const = 0;  // with its symmetries
  virtual const CameraModel& camera() const = 0;
};

// The segments of the object with their model lines.
std::vector<LineMatch> TrueMatches(const LineTrialGenerator& trials, const LineTrial& trial);

PoseError CompareWithTruth(const LineTrialGenerator& trials, const LineTrial& trial,
                           const RigidTransform& camera_from_object);

}  // namespace evpose
