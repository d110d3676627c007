// SPDX-License-Identifier: Apache-2.0

// From events alone to first poses: lines, poses that explain them, and the motion that the lines' own motion tells.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/detection/line_detector.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/pose_search.h"
#include "core/models/object_model.h"

namespace evpose {

// A pose that the lines allow, at the middle of their stretch of time.
struct FirstPose {
  int64_t t_us = 0;
  RigidTransform camera_from_object;
  Vector6d twist = Vector6d::Zero();  // dT/dt = v, dR/dt = w^ R; m/s, rad/s
  Matrix6d twist_covariance = Matrix6d::Zero();
  double cost = 0.0;  // PoseHypothesis::cost
};

struct FirstPoses {
  int num_lines = 0;             // that were detected
  double motion_px = 0.0;        // by which they moved in their stretch of time: upper quartile
  bool has_moved = false;        // by enough to be searched with
  std::vector<FirstPose> poses;  // best first; distinct modulo the model's symmetries
};

struct InitializerOptions {
  // Pixels. Lines that moved by less are not searched with: their events are too few and too near to tell lines from
  // noise, and which of them continue each other.
  double min_motion_px = 1.0;
  // PoseHypothesis::evidence that a pose needs, whatever else: three segments fit in some pose whatever they are, and a
  // segment is worth at most PoseSearchOptions::unexplained_cost.
  double min_evidence = 72.0;
  // A pose also explains most of what there is, as a share of the evidence of all segments, or is worth more than six
  // segments: on cluttered views chance poses were seen to gather up to four.
  double min_explained_ratio = 0.5;
  double sure_evidence = 144.0;
  // Prior of the twist.
  double velocity_px_per_s = 2000.0;        // one standard deviation: fast for an object that fills the image
  double angular_velocity_rad_per_s = 6.0;  // about one turn per second
  double line_error_px = 0.5;               // of a detected line's place at either end of its stretch of time

  absl::Status Validate() const;
};

// The twist at the middle of the time that best explains how the matched lines moved: each end of each line gives its
// normal velocity (core/estimation/README.md, section 2), the prior the rest. `model_line` is
// PoseHypothesis::model_line.
struct TwistEstimate {
  Vector6d twist = Vector6d::Zero();
  Matrix6d covariance = Matrix6d::Zero();
};
TwistEstimate EstimateTwist(const ObjectModel& model, const CameraModel& camera,
                            const RigidTransform& camera_from_object, const LineDetection& detection,
                            absl::Span<const int> model_line, const InitializerOptions& options);

// Deterministic. Not thread-safe.
class PoseInitializer {
 public:
  PoseInitializer(std::shared_ptr<const ObjectModel> model, const CameraModel& camera,
                  std::unique_ptr<LineDetector> detector, std::unique_ptr<PoseSearch> search,
                  const InitializerOptions& options = {});

  // `events` as LineDetector::Detect takes them. Only the lines when they have hardly moved.
  FirstPoses Find(absl::Span<const PixelEvent> events);

 private:
  // More than chance would give.
  bool IsPlausible(const PoseHypothesis& hypothesis) const;

  const std::shared_ptr<const ObjectModel> model_;
  const CameraModel camera_;
  const std::unique_ptr<LineDetector> detector_;
  const std::unique_ptr<PoseSearch> search_;
  const InitializerOptions options_;
};

}  // namespace evpose
