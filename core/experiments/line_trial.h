// Random trials of the first pose: what a line detector might see of an object, and the truth.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/simulation/scene.h"

namespace evpose {

struct LineTrialOptions {
  SimulatedObject object = SimulatedObject::kCube;
  double noise_px = 0.8;  // standard deviation of each coordinate of an end point
  int num_spurious = 0;   // segments of nothing, among the object's
  int num_missing = 0;    // visible lines that were not detected

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

struct LineTrial {
  RigidTransform camera_from_object;   // truth
  std::vector<ImageSegment> segments;  // in random order and direction
  std::vector<int> model_line;         // truth: index into ObjectModel::lines for each segment, -1: spurious
};

// Poses are drawn at random: all attitudes in which the lines determine the pose, wherever the whole object is in view.
class LineTrialGenerator {
 public:
  static absl::StatusOr<std::unique_ptr<LineTrialGenerator>> Create(const LineTrialOptions& options);
  virtual ~LineTrialGenerator() = default;

  // The same seed gives the same trial.
  virtual LineTrial Make(uint64_t seed) const = 0;
  virtual const ObjectModel& model() const = 0;
  virtual const CameraModel& camera() const = 0;
};

struct TrialError {
  double rotation_rad = 0.0;       // modulo the model's symmetries
  double translation_ratio = 0.0;  // distance between the positions, of the true depth
  double reprojection_px = 0.0;    // mean over the end points of the model's lines that are visible at the truth
  bool is_right() const;           // within 2 deg and 2 % of depth
};
TrialError CompareWithTruth(const LineTrialGenerator& trials, const LineTrial& trial,
                            const RigidTransform& camera_from_object);

}  // namespace evpose
