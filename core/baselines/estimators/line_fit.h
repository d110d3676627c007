// SPDX-License-Identifier: Apache-2.0

// Pose from events with known lines: the published estimators under one interface, solved with Ceres (Sec. III-D of the
// paper; core/estimation/README.md, section 1), and the filter with which they are compared. The static estimators of
// the tracker and the synthetic experiment use it.
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
  kTukeyM,        // scale: MAD about the median of the signed distances, updated at every re-weighting
  kTukeyS,        // the scale solves mean(rho(d / sigma)) = 0.1995 at c = 1.547, estimated together with the pose
  kTukeyMm,       // S, then M at c = 4.685 with the fixed scale of S
  // Normal about the line, uniform over the gate; outlier ratio and spread by EM (core/estimation/README.md, section
  // 1).
  kMixture,
  // One pass of an error-state Kalman filter over the events in their order, each a scalar update gated by its
  // chi-square, after Chamorro, Sola, Andrade-Cetto, "High-Speed Event Camera Tracking", BMVC 2020, with a known map
  // and without motion. It ignores LineFitFormulas.
  kErrorStateFilter,
};

enum class LineFitFormulas {
  kCorrected,  // as in core/estimation/README.md, section 1
  // The computation of the paper's released code: MAD of |d|, residuals multiplied by w (hence w squared), w divided by
  // its sum, and solver tolerances of 1e-3, which also end the re-weighting. All else follows the formulas as printed:
  // the scale of S is sqrt(mean(w d^2) / 0.199) and its weight rho / u^2, and MM updates its scale (the paper's
  // Algorithm 1). There is no mixture.
  kReleasedCode,
};

// The defaults are validated by line_fit_test (errors without and with wrong labels, covariance, spreads of 0.5 to 8
// px) and `evpose bench synthetic`, which gives the filter the noise of the trial as filter_sigma_px
// (core/experiments/RESULTS.md, Robust estimation).
struct LineFitOptions {
  LineFitMethod method = LineFitMethod::kTukeyMm;
  LineFitFormulas formulas = LineFitFormulas::kCorrected;
  // Maximum number of re-weighting steps of each stage; with 50 % of wrong labels, M and S converge within 60.
  int max_iterations = 100;
  double tolerance_px = 1e-6;  // re-weighting ends when no distance changes by more
  double min_sigma_px = 0.2;   // lower bound of the scale, below the rounding to pixels (0.29)
  double mixture_gate_px =
      // Pixels: half-width over which the clutter of the mixture is uniform; widened to 4 sigma if that is larger.
      20.0;
  // Standard deviations of the filter, pixels: of the distance of an event, which is fixed, and of the initial pose, as
  // the root mean square displacement of the lines at the events.
  double filter_sigma_px = 2.0;
  double filter_initial_px = 10.0;
  double filter_gate_chi2 = 6.63;  // one degree of freedom, 99 %

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// An event: undistorted bearing (bx, by, 1) and index of the line to which it is assigned.
struct LabelledEvent {
  double bx = 0.0;
  double by = 0.0;
  int line = 0;
};

struct LineFit {
  RigidTransform camera_from_object;
  double sigma_px = 0.0;  // the scale; for LS the root mean square, for the filter filter_sigma_px
  // One per event, in [0, 1]. LS: 1; the filter: 1 if the event passed the gate, otherwise 0.
  std::vector<double> weights;
  // Covariance of [translation, rotation], left perturbation. M, S, MM and mixture: the asymptotic one of an
  // M-estimator, sigma^2 sum(psi^2) / sum(psi')^2 (sum w J^T J / sum w)^-1; LS: sigma^2 (sum J^T J)^-1; the filter: its
  // own.
  Matrix6d covariance = Matrix6d::Zero();
  double residual_rms_px = 0.0;  // weighted root mean square of the distances
  int iterations = 0;            // re-weighting steps
};

// Estimates the pose from the distances of the events to their lines, starting at `initial`. Deterministic. Errors:
// INVALID_ARGUMENT for the options (Validate), for an event that is not finite or has a line index outside of `lines`,
// and for fewer than 6 events; FAILED_PRECONDITION if the events do not determine the pose, or a line with events is
// out of view or leaves it during the fit.
absl::StatusOr<LineFit> FitPoseToLines(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                       absl::Span<const LabelledEvent> events, const RigidTransform& initial,
                                       const LineFitOptions& options);

}  // namespace evpose
