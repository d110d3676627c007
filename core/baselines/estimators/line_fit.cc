// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/estimators/line_fit.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "absl/strings/str_cat.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/numerics/math.h"
#include "core/numerics/robust.h"

namespace evpose {
namespace {

constexpr size_t kMinEvents = 6;  // as many as unknowns

// Influence of an event at u = d / sigma: its weight psi(u) / u in the cost, and psi'(u) for the covariance.
struct Influence {
  double weight = 1.0;
  double slope = 1.0;
};

Influence TukeyInfluence(double u, double c) {
  const double s = (u / c) * (u / c);
  if (s >= 1.0) return {0.0, 0.0};
  return {(1.0 - s) * (1.0 - s), (1.0 - s) * (1.0 - 5.0 * s)};
}

// rho / u^2, the weight of S that the paper prints (core/estimation/README.md, section 1).
Influence PrintedScaleInfluence(double u) {
  constexpr double kSmall = 1e-6;  // below it rho / u^2 is 1/2 to rounding
  if (std::abs(u) < kSmall) return {0.5, 0.5};
  const double rho_ratio = TukeyRho(u, kTukeyBreakdown) / (u * u);
  return {rho_ratio, TukeyWeight(u, kTukeyBreakdown) - rho_ratio};
}

// Residuals multiplied by w, hence w^2 in the cost (core/estimation/README.md, section 1).
Influence Squared(const Influence& of) {
  const double u_times_derivative = of.slope - of.weight;
  return {of.weight * of.weight, of.weight * of.weight + 2.0 * of.weight * u_times_derivative};
}

// Probability that an event belongs to the line, core/estimation/README.md, equation (3). psi' = w - w (1 - w) u^2.
Influence MixtureInfluence(double d_px, const MixtureDensity& density) {
  if (std::abs(d_px) > density.gate_px) return {0.0, 0.0};
  const double u = d_px / density.sigma_px;
  const double line = (1.0 - density.outlier_ratio) * MixtureDensity::kInverseSqrt2Pi / density.sigma_px *
                      DeterministicExp(-0.5 * u * u);
  const double weight = line / (line + density.Outlier());
  return {weight, weight - weight * (1.0 - weight) * u * u};
}

class Fitter {
 public:
  Fitter(const CameraModel& camera, absl::Span<const LineEnds> lines, absl::Span<const LabelledEvent> events,
         const RigidTransform& initial, const LineFitOptions& options)
      : camera_(camera),
        lines_(lines),
        events_(events),
        options_(options),
        is_released_(options.formulas == LineFitFormulas::kReleasedCode),
        pose_(initial),
        projected_(lines.size()),
        moments_(lines.size()),
        residuals_(events.size(), 0.0),
        influences_(events.size()) {}

  absl::StatusOr<LineFit> Run();

 private:
  absl::Status Fit();
  // Performs one filter update per event. `inverse`: the inverse Hessian of all events at the initial pose.
  absl::StatusOr<LineFit> Filter(const Matrix6d& inverse) const;
  // Performs one stage of re-weighting: `reweight` sets scale and influences from the residuals.
  template <typename Reweight>
  absl::Status Iterate(double tolerance_px, const Reweight& reweight);
  absl::Status FitTukeyM(double tolerance_px, bool updates_scale);
  absl::Status FitTukeyS();
  absl::Status FitMixture();

  // Scale by MAD, as the formulas say: of |d| about its median in the released ones, else of d about its median.
  void SetMadScale();
  void UpdateScaleOfS();  // one step of the scale of the S estimator
  void SetSigma(double sigma_px) { sigma_px_ = std::max(sigma_px, options_.min_sigma_px); }
  void WeighByTukey(double c);
  void WeighAsReleased(double c);

  // Computes the residuals at the present pose; returns the largest change.
  absl::StatusOr<double> Project();
  void SumMoments();
  absl::StatusOr<LineFit> Report() const;

  const CameraModel& camera_;
  const absl::Span<const LineEnds> lines_;
  const absl::Span<const LabelledEvent> events_;
  const LineFitOptions& options_;
  const bool is_released_;

  RigidTransform pose_;
  double sigma_px_ = 0.0;
  int iterations_ = 0;
  std::vector<std::optional<ProjectedLine>> projected_;
  std::vector<LineMoment> moments_;
  std::vector<double> residuals_;
  std::vector<double> scratch_;
  std::vector<Influence> influences_;  // weights as they enter the cost
  std::vector<double> shown_weights_;  // weights of the released code, before they are squared and scaled
};

absl::Status OutOfView(size_t line) {
  return absl::FailedPreconditionError(absl::StrCat("line ", line, " has events, but is not in view"));
}

absl::StatusOr<double> Fitter::Project() {
  std::vector<bool> used(lines_.size(), false);
  for (const LabelledEvent& event : events_) used[event.line] = true;
  for (size_t k = 0; k < lines_.size(); ++k) {
    projected_[k] = ProjectLine(camera_, pose_, lines_[k].p1, lines_[k].p2);
    if (used[k] && !projected_[k]) return OutOfView(k);
  }
  double largest = 0.0;
  for (size_t i = 0; i < events_.size(); ++i) {
    const Eigen::Vector3d& a = projected_[events_[i].line]->a;
    const double d = a.x() * events_[i].bx + a.y() * events_[i].by + a.z();
    largest = std::max(largest, std::abs(d - residuals_[i]));
    residuals_[i] = d;
  }
  return largest;
}

void Fitter::SumMoments() {
  std::fill(moments_.begin(), moments_.end(), LineMoment::Zero());
  for (size_t i = 0; i < events_.size(); ++i) {
    const Eigen::Vector3d b(events_[i].bx, events_[i].by, 1.0);
    moments_[events_[i].line] += (influences_[i].weight * b) * b.transpose();
  }
}

void Fitter::SetMadScale() {
  scratch_ = residuals_;
  if (is_released_) {
    for (double& d : scratch_) d = std::abs(d);
  }
  SetSigma(MadScale(scratch_));
}

void Fitter::UpdateScaleOfS() {
  constexpr double kPrintedScaleTarget = 0.199;  // the constant in the paper's formula of the scale of S
  if (!is_released_) return SetSigma(TukeyScale(residuals_, sigma_px_));
  if (shown_weights_.empty()) return;
  double squares = 0.0;
  for (size_t i = 0; i < residuals_.size(); ++i) squares += shown_weights_[i] * residuals_[i] * residuals_[i];
  SetSigma(std::sqrt(squares / (kPrintedScaleTarget * static_cast<double>(residuals_.size()))));
}

void Fitter::WeighByTukey(double c) {
  if (is_released_) return WeighAsReleased(c);
  for (size_t i = 0; i < residuals_.size(); ++i) influences_[i] = TukeyInfluence(residuals_[i] / sigma_px_, c);
}

void Fitter::WeighAsReleased(double c) {
  double sum = 0.0;
  shown_weights_.resize(residuals_.size());
  for (size_t i = 0; i < residuals_.size(); ++i) {
    const double u = residuals_[i] / sigma_px_;
    influences_[i] = c == kTukeyBreakdown ? PrintedScaleInfluence(u) : TukeyInfluence(u, c);
    shown_weights_[i] = influences_[i].weight;
    sum += influences_[i].weight;
  }
  if (!(sum > 0.0)) return;
  for (Influence& influence : influences_) {
    influence = Squared({influence.weight / sum, influence.slope / sum});
  }
}

template <typename Reweight>
absl::Status Fitter::Iterate(double tolerance_px, const Reweight& reweight) {
  constexpr double kReleasedTolerance = 1e-3;  // solver tolerance of the released code
  ceres::Solver::Options solver = LineSolverOptions();
  if (is_released_) {
    solver.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
    solver.function_tolerance = solver.gradient_tolerance = solver.parameter_tolerance = kReleasedTolerance;
  }
  EVPOSE_RETURN_IF_ERROR(Project().status());
  for (int k = 0; k < options_.max_iterations; ++k) {
    reweight();
    SumMoments();
    EVPOSE_ASSIGN_OR_RETURN(pose_, MinimiseLineCost(camera_, lines_, moments_, pose_, solver));
    EVPOSE_ASSIGN_OR_RETURN(const double moved_px, Project());
    ++iterations_;
    if (moved_px < tolerance_px) break;
  }
  return absl::OkStatus();
}

absl::Status Fitter::FitTukeyM(double tolerance_px, bool updates_scale) {
  return Iterate(tolerance_px, [&] {
    if (updates_scale) SetMadScale();
    WeighByTukey(kTukeyEfficient);
  });
}

absl::Status Fitter::FitTukeyS() {
  EVPOSE_RETURN_IF_ERROR(Project().status());
  SetMadScale();
  return Iterate(options_.tolerance_px, [&] {
    UpdateScaleOfS();
    WeighByTukey(kTukeyBreakdown);
  });
}

absl::Status Fitter::FitMixture() {
  constexpr double kStartTolerancePx = 0.5;  // pixels; the start must only be nearer than the spread
  // Standard deviations at which the normal density reaches the gate; the share beyond, 6e-5, is negligible.
  constexpr double kGateSigmas = 4.0;
  // EM finds only the nearest maximum, and an initial pose far from the truth has several. Tukey's M with a scale that
  // includes half of the events leads to the neighbourhood of the right one.
  EVPOSE_RETURN_IF_ERROR(FitTukeyM(kStartTolerancePx, /*updates_scale=*/true));
  SetMadScale();
  MixtureDensity density{sigma_px_, 0.5, std::max(options_.mixture_gate_px, kGateSigmas * sigma_px_)};
  return Iterate(options_.tolerance_px, [&] {
    double gated = 0.0, explained = 0.0, squares = 0.0;
    for (size_t i = 0; i < residuals_.size(); ++i) {
      influences_[i] = MixtureInfluence(residuals_[i], density);
      if (std::abs(residuals_[i]) <= density.gate_px) gated += 1.0;
      explained += influences_[i].weight;
      squares += influences_[i].weight * residuals_[i] * residuals_[i];
    }
    if (!(explained > 0.0)) return;
    SetSigma(std::sqrt(squares / explained));
    density = {sigma_px_, 1.0 - explained / gated, std::max(options_.mixture_gate_px, kGateSigmas * sigma_px_)};
  });
}

absl::Status Fitter::Fit() {
  switch (options_.method) {
    case LineFitMethod::kTukeyM:
      return FitTukeyM(options_.tolerance_px, /*updates_scale=*/true);
    case LineFitMethod::kTukeyS:
      return FitTukeyS();
    case LineFitMethod::kTukeyMm:
      EVPOSE_RETURN_IF_ERROR(FitTukeyS());
      return FitTukeyM(options_.tolerance_px, /*updates_scale=*/is_released_);
    case LineFitMethod::kMixture:
      return FitMixture();
    default:
      return Iterate(options_.tolerance_px, [] {});
  }
}

absl::StatusOr<LineFit> Fitter::Report() const {
  LineFit fit;
  fit.camera_from_object = pose_;
  fit.iterations = iterations_;
  double weight = 0.0, squares = 0.0, slope = 0.0, psi_squares = 0.0;
  for (size_t i = 0; i < residuals_.size(); ++i) {
    const double w = influences_[i].weight;
    const double d2 = residuals_[i] * residuals_[i];
    fit.weights.push_back(shown_weights_.empty() ? w : shown_weights_[i]);
    weight += w;
    slope += influences_[i].slope;
    squares += w * d2;
    psi_squares += w * w * d2;
  }
  fit.residual_rms_px = std::sqrt(squares / weight);
  fit.sigma_px = options_.method == LineFitMethod::kLeastSquares ? fit.residual_rms_px : sigma_px_;
  EVPOSE_ASSIGN_OR_RETURN(const Matrix6d inverse, InvertPoseHessian(LineCostHessian(projected_, moments_)));
  // For a redescending psi the sum of the slopes may vanish; the information is then bounded below by that of one
  // event.
  const double information = std::max(slope, weight / static_cast<double>(residuals_.size()));
  fit.covariance = inverse * (weight * psi_squares / (information * information));
  return fit;
}

absl::StatusOr<LineFit> Fitter::Filter(const Matrix6d& inverse) const {
  LineFit fit;
  fit.camera_from_object = pose_;
  fit.sigma_px = options_.filter_sigma_px;
  fit.iterations = 1;
  // Initially the mean square displacement of the lines at the events is filter_initial_px squared: the mean of J P J^T
  // over the events is 6 times the factor. The shape of the covariance is that of the information of the events, so
  // that neither the size of the object nor its distance matters.
  const double initial_px = options_.filter_initial_px;
  fit.covariance = inverse * (static_cast<double>(events_.size()) * initial_px * initial_px / 6.0);
  const double variance_px2 = options_.filter_sigma_px * options_.filter_sigma_px;
  double accepted = 0.0, squares = 0.0;
  for (const LabelledEvent& event : events_) {
    // Linearised again for every event, because the pose has moved.
    const LineEnds& ends = lines_[event.line];
    const std::optional<ProjectedLine> line = ProjectLine(camera_, fit.camera_from_object, ends.p1, ends.p2);
    if (!line) return OutOfView(event.line);
    const Eigen::Vector3d b(event.bx, event.by, 1.0);
    const double d = line->a.dot(b);
    const Vector6d row = line->jacobian.transpose() * b;
    const Vector6d gain_times_variance = fit.covariance * row;
    const double innovation_variance = row.dot(gain_times_variance) + variance_px2;
    const bool passes = d * d <= options_.filter_gate_chi2 * innovation_variance;
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

absl::StatusOr<LineFit> Fitter::Run() {
  // Checks whether all events together determine the pose, before any of them is rejected.
  EVPOSE_RETURN_IF_ERROR(Project().status());
  SumMoments();
  EVPOSE_ASSIGN_OR_RETURN(const Matrix6d inverse, InvertPoseHessian(LineCostHessian(projected_, moments_)));
  if (options_.method == LineFitMethod::kErrorStateFilter) return Filter(inverse);
  EVPOSE_RETURN_IF_ERROR(Fit());
  return Report();
}

absl::Status CheckEvents(absl::Span<const LineEnds> lines, absl::Span<const LabelledEvent> events) {
  if (events.size() < kMinEvents) {
    return absl::InvalidArgumentError(
        absl::StrCat("a pose has 6 unknowns: ", events.size(), " events are too few, 6 are needed"));
  }
  for (size_t i = 0; i < events.size(); ++i) {
    const LabelledEvent& event = events[i];
    if (event.line < 0 || static_cast<size_t>(event.line) >= lines.size()) {
      return absl::InvalidArgumentError(
          absl::StrCat("event ", i, " is of line ", event.line, ", but there are ", lines.size(), " lines"));
    }
    if (!std::isfinite(event.bx) || !std::isfinite(event.by)) {
      return absl::InvalidArgumentError(absl::StrCat("event ", i, " has a bearing that is not finite"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status LineFitOptions::Validate() const {
  if (formulas == LineFitFormulas::kReleasedCode && method == LineFitMethod::kMixture) {
    return absl::InvalidArgumentError("formulas: the released code has no mixture; choose the corrected formulas");
  }
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_iterations", max_iterations, 1, 10'000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("tolerance_px", tolerance_px, 1e-12, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_sigma_px", min_sigma_px, 1e-6, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("mixture_gate_px", mixture_gate_px, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("filter_sigma_px", filter_sigma_px, 1e-3, 100.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("filter_initial_px", filter_initial_px, 1e-3, 1000.0));
  return CheckRange("filter_gate_chi2", filter_gate_chi2, 0.1, 1000.0);
}

absl::StatusOr<LineFit> FitPoseToLines(const CameraModel& camera, absl::Span<const LineEnds> lines,
                                       absl::Span<const LabelledEvent> events, const RigidTransform& initial,
                                       const LineFitOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckEvents(lines, events));
  return Fitter(camera, lines, events, initial, options).Run();
}

}  // namespace evpose
