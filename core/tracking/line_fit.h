// Pose from events whose lines are known: the published estimators under one interface, served by Ceres (the paper's
// Sec. III-D; method.md 2.6). What the static window estimators and the synthetic experiment share.
#pragma once

#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

enum class LineFitMethod {
  kLeastSquares,  // w = 1
  kTukeyM,        // scale: MAD about the median of the signed distances, once, at the start
  kTukeyS,        // the scale that solves mean(rho(d / sigma)) = 0.199 at c = 1.547, together with the pose
  kTukeyMm,       // S, then M at c = 4.685 with the scale of S, frozen
  kMixture,       // normal about the line, uniform over the gate (method.md 2.6)
};

enum class LineFitFormulas {
  kCorrected,  // as method.md 2.6 has them
  // As the paper's released code computes: MAD of |d|, the residual times w (so w squared), w divided by its sum,
  // solver tolerances of 1e-3.
  kReleasedCode,
};

struct LineFitOptions {
  LineFitMethod method = LineFitMethod::kTukeyMm;
  LineFitFormulas formulas = LineFitFormulas::kCorrected;
  int max_iterations = 50;        // re-weighting steps of each stage
  double min_sigma_px = 0.2;      // a scale below the rounding of pixels (0.29) means nothing
  double mixture_gate_px = 20.0;  // half-width over which the mixture's clutter is uniform

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Object frame, metres.
struct LineEnds {
  Eigen::Vector3d p1;
  Eigen::Vector3d p2;
};

// An event, undistorted bearing (bx, by, 1), and the index of the line that it is said to belong to.
struct LabelledEvent {
  double bx = 0.0;
  double by = 0.0;
  int line = 0;
};

struct LineFit {
  RigidTransform camera_from_object;
  double sigma_px = 0.0;                   // the scale; of LS the root mean square
  std::vector<double> weights;             // one per event, in [0, 1]; LS: 1
  Matrix6d covariance = Matrix6d::Zero();  // sigma^2 (sum w J^T J)^-1, of [translation, rotation], left perturbation
  double residual_rms_px = 0.0;            // weighted
  int iterations = 0;                      // of the re-weighting
};

// Minimises the events' distances to their lines from `initial`. Deterministic.
// Errors: INVALID_ARGUMENT for an event whose line does not exist or fewer than 6 events; FAILED_PRECONDITION when the
// events do not determine the pose, or the lines leave the view on the way.
absl::StatusOr<LineFit> FitPoseToLines(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                       absl::Span<const LabelledEvent> events, const RigidTransform& initial,
                                       const LineFitOptions& options);

}  // namespace evpose
