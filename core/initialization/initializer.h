// SPDX-License-Identifier: Apache-2.0

// First poses from events alone: detects lines, searches for the poses that explain them, and estimates the twist from
// the motion of the lines. For objects with curved edges, templates of all views are compared with the events, too.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/types/span.h"
#include "core/detection/line_detector.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/pose_search.h"
#include "core/initialization/templates/template_search.h"
#include "core/initialization/templates/twist_equations.h"
#include "core/models/object_model.h"

namespace evpose {

// A pose that is consistent with the detected lines or edges, at the middle of their time interval.
struct FirstPose {
  int64_t t_us = 0;
  RigidTransform camera_from_object;
  Vector6d twist = Vector6d::Zero();  // dT/dt = v in m/s, dR/dt = [w]x R with w in rad/s
  Matrix6d twist_covariance = Matrix6d::Zero();
};

struct FirstPoses {
  int num_lines = 0;             // number of detected lines
  double motion_px = 0.0;        // upper quartile of the displacements of the lines within their interval
  bool has_moved = false;        // the displacement is large enough for a search
  bool uses_contours = false;    // templates of the contours were searched for, too
  std::vector<FirstPose> poses;  // the best one first; distinct modulo the model's symmetries
};

// max_false_alarms is validated by false_alarms_test, min_motion_px by event_trials_test (time until the first pose)
// and tracker_initialization_test (an object that hardly moves). initializer_test bounds line_error_px from above.
// `evpose bench initialization --from-events` runs with the defaults (core/experiments/RESULTS.md, The first pose).
struct InitializerOptions {
  // Smallest displacement, in pixels, with which a search starts. With a smaller one there are too few events, too
  // close together, to separate lines from noise and to decide which lines are collinear.
  double min_motion_px = 1.0;
  // Largest PoseHypothesis::expected_false_alarms of a pose: of ten searches in views of clutter alone, one returns a
  // pose. The events reject it within a few milliseconds (core/tracking/README.md), so that more would cost processor
  // time only.
  double max_false_alarms = 0.1;
  TwistPrior twist_prior;
  // Pixels: standard deviation of the position of a detected line at either end of its interval, from the rounding of
  // pixels and the width of an edge. With a smaller value the twist follows the errors of single lines more than the
  // prior.
  double line_error_px = 0.5;
};

// Returns the twist at the middle of the interval that best explains the motion of the matched lines, and its
// covariance (README, equation (9)). Each end of each line gives its normal velocity, and the prior constrains the
// remaining directions. `model_line` is PoseHypothesis::model_line.
TwistEstimate EstimateTwist(const ObjectModel& model, const CameraModel& camera,
                            const RigidTransform& camera_from_object, const LineDetection& detection,
                            absl::Span<const int> model_line, const InitializerOptions& options);

// Deterministic; not thread-safe.
class PoseInitializer {
 public:
  // Several initializers of one thread may share detectors, which keep no state between calls. The detectors detect
  // lines of different lengths; Find() uses them in this order until the lines of one of them give a pose. `search` is
  // null if the lines of the model determine no pose, and `templates` is null if the model has no curved edges. At
  // least one of both must not be null.
  PoseInitializer(std::shared_ptr<const ObjectModel> model, const CameraModel& camera,
                  std::vector<std::shared_ptr<LineDetector>> detectors, std::unique_ptr<PoseSearch> search,
                  std::unique_ptr<TemplateSearch> templates = nullptr);

  // `events` are as LineDetector::Detect requires. If the edges have hardly moved, the result has lines but no poses.
  FirstPoses Find(absl::Span<const PixelEvent> events);

 private:
  FirstPoses FindByLines(absl::Span<const PixelEvent> events, LineDetector& detector);
  // Replaces the poses by those of the template search, which scores them together with its own.
  void FindByContours(absl::Span<const PixelEvent> events, FirstPoses& first);
  // Returns whether the expected number of false alarms is at most max_false_alarms.
  bool IsPlausible(const PoseHypothesis& hypothesis) const;

  const std::shared_ptr<const ObjectModel> model_;
  const CameraModel camera_;
  const std::vector<std::shared_ptr<LineDetector>> detectors_;
  const std::unique_ptr<PoseSearch> search_;
  const std::unique_ptr<TemplateSearch> templates_;
  const InitializerOptions options_;
};

}  // namespace evpose
