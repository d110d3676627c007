// SPDX-License-Identifier: Apache-2.0

// Pose from events whose lines are known: the published estimators under one interface, served by Ceres (the paper's
// Sec. III-D; core/estimation/README.md, section 1), and the filter they are compared with. What the static window
// estimators and the synthetic experiment share.
#pragma once

#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/estimators/line_cost.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

enum class LineFitMethod {
  kLeastSquares,  // w = 1
  kTukeyM,        // scale: MAD about the median of the signed distances, anew at every re-weighting
  kTukeyS,        // the scale that solves mean(rho(d / sigma)) = 0.1995 at c = 1.547, together with the pose
  kTukeyMm,       // S, then M at c = 4.685 with the scale of S, frozen
  kMixture,  // normal about the line, uniform over the gate; share and spread by EM (core/estimation/README.md, section
             // 1)
  // One sweep of an error-state Kalman filter over the events in their order, each a scalar update gated by its
  // chi-square, after Chamorro, Sola, Andrade-Cetto, "High-Speed Event Camera Tracking", BMVC 2020, with a map that is
  // known and no motion. The formulas play no part.
  kErrorStateFilter,
};

enum class LineFitFormulas {
  kCorrected,  // as core/estimation/README.md, section 1 has them
  // As the paper's released code computes: MAD of |d|, the residual times w (so w squared), w divided by its sum,
  // solver tolerances of 1e-3, at which the re-weighting ends, too; else by the paper's formulas as printed: the scale
  // and weight of S by its eqs. (eqs4), (eqs5), MM with a scale that goes on changing (its Algorithm 1). There is no
  // mixture in it.
  kReleasedCode,
};

struct LineFitOptions {
  LineFitMethod method = LineFitMethod::kTukeyMm;
  LineFitFormulas formulas = LineFitFormulas::kCorrected;
  // Re-weighting steps of each stage; at 50 % of wrong labels M and S take up to 60 until nothing moves.
  int max_iterations = 100;
  double tolerance_px = 1e-6;  // re-weighting ends when no event's distance changes by more
  double min_sigma_px = 0.2;   // a scale below the rounding of pixels (0.29) means nothing
  double mixture_gate_px =
      20.0;  // half-width over which the mixture's clutter is uniform; wider while sigma asks for it
  // The filter's standard deviations, pixels: of an event's distance, which it is told and never learns, and of the
  // initial pose, as the mean square distance over all events that it causes.
  double filter_sigma_px = 2.0;
  double filter_initial_px = 10.0;
  double filter_gate_chi2 = 6.63;  // one degree of freedom, 99 %

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// An event, undistorted bearing (bx, by, 1), and the index of the line that it is said to belong to.
struct LabelledEvent {
  double bx = 0.0;
  double by = 0.0;
  int line = 0;
};

struct LineFit {
  RigidTransform camera_from_object;
  double sigma_px = 0.0;        // the scale; of LS the root mean square; of the filter what it was told
  std::vector<double> weights;  // one per event, in [0, 1]; LS: 1; the filter: whether the event passed the gate
  // Of [translation, rotation], left perturbation. M, S, MM and mixture: asymptotic, of an M-estimator,
  // sigma^2 sum(psi^2) / sum(psi')^2 (sum w J^T J / sum w)^-1; LS: sigma^2 (sum J^T J)^-1; the filter: its own.
  Matrix6d covariance = Matrix6d::Zero();
  double residual_rms_px = 0.0;  // weighted
  int iterations = 0;            // of the re-weighting
};

// Minimises the events' distances to their lines from `initial`. Deterministic.
// Errors: INVALID_ARGUMENT for options (Validate), an event whose line does not exist or that is not finite, fewer
// than 6 events; FAILED_PRECONDITION when the events do not determine the pose, or a line with events is out of view
// or leaves it on the way.
absl::StatusOr<LineFit> FitPoseToLines(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                       absl::Span<const LabelledEvent> events, const RigidTransform& initial,
                                       const LineFitOptions& options);

}  // namespace evpose
