// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/estimators/line_filter.h"

#include <cmath>
#include <optional>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

absl::Status OutOfView(int line) {
  return absl::FailedPreconditionError(absl::StrCat("line ", line, " has events, but is not in view"));
}

// Initial covariance: the one under which the mean square displacement of the lines at the events is filter_initial_px
// squared. Its shape is that of the information of the events, so that neither the size of the object nor its distance
// matters.
absl::StatusOr<Matrix6d> InitialCovariance(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                           absl::Span<const LabelledEvent> events, const RigidTransform& initial,
                                           double initial_px) {
  std::vector<LineMoment> moments(lines.size(), LineMoment::Zero());
  for (const LabelledEvent& event : events) {
    const Eigen::Vector3d b(event.bx, event.by, 1.0);
    moments[event.line] += b * b.transpose();
  }
  std::vector<std::optional<ProjectedLine>> projected;
  for (size_t k = 0; k < lines.size(); ++k) {
    projected.push_back(ProjectLine(camera, initial, lines[k].p1, lines[k].p2));
    if (!projected.back() && moments[k](2, 2) > 0.0) return OutOfView(static_cast<int>(k));
  }
  EVPOSE_ASSIGN_OR_RETURN(const Matrix6d inverse, InvertPoseHessian(LineCostHessian(projected, moments)));
  // The mean of J P J^T over the events is 6 times the factor.
  return Matrix6d(inverse * (static_cast<double>(events.size()) * initial_px * initial_px / 6.0));
}

}  // namespace

absl::StatusOr<LineFit> FilterPose(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                   absl::Span<const LabelledEvent> events, const RigidTransform& initial,
                                   const LineFitOptions& options) {
  LineFit fit;
  fit.camera_from_object = initial;
  fit.sigma_px = options.filter_sigma_px;
  fit.iterations = 1;
  EVPOSE_ASSIGN_OR_RETURN(fit.covariance, InitialCovariance(camera, lines, events, initial, options.filter_initial_px));
  const double variance_px2 = options.filter_sigma_px * options.filter_sigma_px;
  double accepted = 0.0, squares = 0.0;
  for (const LabelledEvent& event : events) {
    // Linearised again for every event, because the pose has moved.
    const LineEnds& ends = lines[event.line];
    const std::optional<ProjectedLine> line = ProjectLine(camera, fit.camera_from_object, ends.p1, ends.p2);
    if (!line) return OutOfView(event.line);
    const Eigen::Vector3d b(event.bx, event.by, 1.0);
    const double d = line->a.dot(b);
    const Vector6d row = line->jacobian.transpose() * b;
    const Vector6d gain_times_variance = fit.covariance * row;
    const double innovation_variance = row.dot(gain_times_variance) + variance_px2;
    const bool passes = d * d <= options.filter_gate_chi2 * innovation_variance;
    fit.weights.push_back(passes ? 1.0 : 0.0);
    if (!passes) continue;
    accepted += 1.0;
    squares += d * d;
    const Vector6d gain = gain_times_variance / innovation_variance;
    fit.camera_from_object = Perturb(fit.camera_from_object, -d * gain);
    fit.covariance -= gain * gain_times_variance.transpose();
  }
  fit.covariance = (0.5 * (fit.covariance + fit.covariance.transpose())).eval();
  fit.residual_rms_px = accepted > 0.0 ? std::sqrt(squares / accepted) : 0.0;
  return fit;
}

}  // namespace evpose
