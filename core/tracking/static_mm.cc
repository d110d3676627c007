// The published static fit (the paper's Sec. III-C and III-D, with the corrections of method.md 2.6): one pose for all
// events of the window, each event given to one line by fixed gates at the predicted pose, Tukey S and then MM.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

#include "core/tracking/estimator.h"
#include "core/tracking/line_sums.h"
#include "core/tracking/robust.h"

namespace evpose {
namespace {

struct AssociatedEvent {
  double bx = 0.0;
  double by = 0.0;
  int line = 0;
};

class StaticMmEstimator : public WindowEstimator {
 public:
  StaticMmEstimator(const StaticMmOptions& options, const CameraModel& camera) : options_(options), camera_(camera) {}

  double ReachPx(double, double gate_factor) const override { return options_.distance_px * gate_factor; }
  int MaxEvents() const override { return options_.max_events; }
  WindowFit Fit(const MotionState& predicted, const WindowInput& input, double gate_factor) override;
  void Accept(const WindowFit& fit, const WindowInput&) override {
    last_ = fit.state;
    has_last_ = true;
  }
  void Reset() override { has_last_ = false; }

 private:
  void Associate(const WindowInput& input, double gate_factor);
  void Residuals();
  // Re-weighted least squares with Tukey's weights at c; with `rescale` the S scale is solved for at every step.
  bool Iterate(double c, bool rescale, const WindowInput& input, MotionState& state, double& sigma_px);
  Matrix6d Hessian(double c, double sigma_px, Vector6d& gradient) const;

  const StaticMmOptions options_;
  const CameraModel camera_;
  bool has_last_ = false;
  MotionState last_;
  std::vector<ImageLine> lines_;
  std::vector<AssociatedEvent> events_;
  std::vector<double> residuals_;
  std::vector<double> scratch_;
};

// "Static": the lines do not move within the window.
void Project(const CameraModel& camera, const MotionState& state, const WindowInput& input,
             std::vector<ImageLine>& lines) {
  MotionState still = state;
  still.twist.setZero();
  ProjectLines(camera, still, input.lines, lines);
}

void StaticMmEstimator::Associate(const WindowInput& input, double gate_factor) {
  events_.clear();
  for (const Observation& event : input.events) {
    const NearLines near =
        FindNearLines(event, input.grid->Lines(event.tile), lines_.data(), options_.distance_px * gate_factor, 0.0);
    if (near.count == 0) continue;
    if (near.count == 2 && std::abs(near.distance_px[1]) < options_.two_lines_px) continue;
    const ImageLine& line = lines_[near.line[0]];
    const Eigen::Vector2d from_middle = Eigen::Vector2d(event.u_px, event.v_px) - line.PointAt(0.5);
    if (from_middle.norm() >= options_.midpoint_ratio * line.length_px) continue;
    events_.push_back({event.bx, event.by, near.line[0]});
  }
}

void StaticMmEstimator::Residuals() {
  residuals_.resize(events_.size());
  for (size_t i = 0; i < events_.size(); ++i) {
    const Eigen::Vector3d& a = lines_[events_[i].line].a;
    residuals_[i] = a.x() * events_[i].bx + a.y() * events_[i].by + a.z();
  }
}

Matrix6d StaticMmEstimator::Hessian(double c, double sigma_px, Vector6d& gradient) const {
  std::vector<LineSums> sums(lines_.size());
  for (size_t i = 0; i < events_.size(); ++i) {
    sums[events_[i].line].Add(events_[i].bx, events_[i].by, 0.0, TukeyWeight(residuals_[i] / sigma_px, c));
  }
  Matrix12d hessian = Matrix12d::Zero();
  Vector12d full_gradient = Vector12d::Zero();
  for (size_t k = 0; k < lines_.size(); ++k) {
    AddNormalEquations(sums[k], lines_[k].a, Eigen::Vector3d::Zero(), lines_[k].jacobian, 1.0, hessian, full_gradient);
  }
  gradient = full_gradient.head<6>();
  return hessian.topLeftCorner<6, 6>();
}

bool StaticMmEstimator::Iterate(double c, bool rescale, const WindowInput& input, MotionState& state,
                                double& sigma_px) {
  for (int k = 0; k < options_.max_iterations; ++k) {
    Residuals();
    if (rescale) sigma_px = TukeyScale(residuals_, sigma_px);
    Vector6d gradient;
    Matrix6d hessian = Hessian(c, sigma_px, gradient);
    // Only against an exactly singular matrix: a millionth of the curvature that there is.
    hessian.diagonal() *= 1.0 + 1e-6;
    const Vector6d dx = -hessian.ldlt().solve(gradient);
    if (!dx.allFinite()) return false;
    double moved_px = 0.0;
    for (const ImageLine& line : lines_) {
      if (!line.in_view()) continue;
      const Eigen::Vector3d middle = BearingOf(camera_, line.PointAt(0.5));
      moved_px = std::max(moved_px, std::abs(middle.dot(line.jacobian * dx)));
    }
    state.camera_from_object = Perturb(state.camera_from_object, dx);
    Project(camera_, state, input, lines_);
    if (moved_px < options_.tolerance_px) break;
  }
  Residuals();
  return true;
}

WindowFit StaticMmEstimator::Fit(const MotionState& predicted, const WindowInput& input, double gate_factor) {
  constexpr size_t kMinEvents = 12;    // twice the unknowns
  constexpr double kMinSigmaPx = 0.2;  // below the rounding of pixels (0.29) a scale means nothing
  WindowFit fit;
  fit.state = predicted;
  Project(camera_, predicted, input, lines_);
  Associate(input, gate_factor);
  fit.num_gated = static_cast<double>(events_.size());
  if (events_.size() < kMinEvents) return fit;

  Residuals();
  scratch_ = residuals_;
  double sigma_px = std::max(MadScale(scratch_), kMinSigmaPx);
  MotionState state = predicted;
  if (!Iterate(kTukeyBreakdown, true, input, state, sigma_px)) return fit;
  sigma_px = std::max(sigma_px, kMinSigmaPx);
  if (!Iterate(kTukeyEfficient, false, input, state, sigma_px)) return fit;

  double weight = 0.0;
  double squares = 0.0;
  for (const double d : residuals_) {
    const double w = TukeyWeight(d / sigma_px, kTukeyEfficient);
    weight += w;
    squares += w * d * d;
  }
  fit.num_explained = weight;
  fit.residual_rms_px = weight > 0.0 ? std::sqrt(squares / weight) : 0.0;

  Vector6d gradient;
  const Matrix6d hessian = Hessian(kTukeyEfficient, sigma_px, gradient) / (sigma_px * sigma_px);
  const Matrix6d covariance = hessian.ldlt().solve(Matrix6d::Identity());
  if (!covariance.allFinite()) return fit;
  state.covariance.setZero();
  state.covariance.topLeftCorner<6, 6>() = 0.5 * (covariance + covariance.transpose());
  // Constant twist from the last two poses (the paper's eqs. (eqd-3), (eqd-4)).
  const double dt = has_last_ ? static_cast<double>(state.t_us - last_.t_us) * 1e-6 : 0.0;
  if (dt > 0.0) state.twist = Difference(state.camera_from_object, last_.camera_from_object) / dt;
  fit.state = state;
  return fit;
}

}  // namespace

std::unique_ptr<WindowEstimator> MakeStaticMmEstimator(const TrackerOptions& options, const CameraModel& camera) {
  return std::make_unique<StaticMmEstimator>(options.static_mm, camera);
}

}  // namespace evpose
