// SPDX-License-Identifier: Apache-2.0

// The published static fit (Sec. III-C and III-D of the paper, with the corrections of core/estimation/README.md,
// section 1): one pose for all events of the window. Each event is assigned to one line by fixed gates at the predicted
// pose, and the pose is estimated by LS, M, S or MM (line_fit.h). The variant of the released code has wider gates,
// uses all lines including hidden ones, and starts at the last pose without a prediction.
#include "core/baselines/estimators/static_estimator.h"

#include <cmath>
#include <vector>

#include "core/association/other_objects.h"
#include "core/estimation/estimator.h"

namespace evpose {
namespace {

class StaticEstimator : public WindowEstimator {
 public:
  StaticEstimator(LineFitMethod method, LineFitFormulas formulas, const CameraModel& camera)
      : is_released_(formulas == LineFitFormulas::kReleasedCode), camera_(camera) {
    fit_options_.method = method;
    fit_options_.formulas = formulas;
    fit_options_.max_iterations = options_.max_iterations;
    fit_options_.tolerance_px = options_.tolerance_px;
  }

  double ReachPx(double, double gate_factor) const override { return DistancePx(gate_factor); }
  int MaxEvents() const override { return options_.max_events; }
  bool UsesVisibility() const override { return !is_released_; }
  bool UsesPrediction() const override { return !is_released_; }
  void Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) override;
  void Accept(const WindowFit& fit, const WindowInput&) override {
    last_ = fit.state;
    has_last_ = true;
  }
  void SaveState(StateWriter& writer) const override { VisitState(writer, *this); }
  void LoadState(StateReader& reader) override { VisitState(reader, *this); }
  static void VisitState(auto& archive, auto& self) {
    auto& [is_released, options, camera, fit_options, has_last, last, lines, ends, events] = self;
    archive(has_last, last);
  }

 private:
  // The released code has no second try; its gate is fixed.
  double DistancePx(double gate_factor) const {
    return is_released_ ? options_.released_distance_px : options_.distance_px * gate_factor;
  }
  void Associate(const MotionState& predicted, const WindowInput& input, double gate_factor);

  const bool is_released_;
  const StaticOptions options_ = {};
  const CameraModel camera_;
  LineFitOptions fit_options_;
  bool has_last_ = false;
  MotionState last_;
  std::vector<ImageLine> lines_;
  std::vector<LineEnds> ends_;
  std::vector<LabelledEvent> events_;
};

void StaticEstimator::Associate(const MotionState& predicted, const WindowInput& input, double gate_factor) {
  // Static: the lines do not move within the window.
  MotionState still = predicted;
  still.twist.setZero();
  ProjectLines(camera_, still, input.lines, lines_);
  ends_.clear();
  for (const TrackedLine& line : input.lines) ends_.push_back({line.p1, line.p2});
  // An event must belong to this object more likely than to another one: hard association, as between lines.
  constexpr double kMinOwnShare = 0.5;
  events_.clear();
  for (const Observation& event : input.events) {
    const NearLines near = FindNearLines(event, lines_.data(), DistancePx(gate_factor), 0.0);
    if (near.count == 0) continue;
    if (near.count == 2 && std::abs(near.distance_px[1]) < options_.two_lines_px) continue;
    if (OwnShare(near.distance_px[0], event.others_per_px) < kMinOwnShare) continue;
    const ImageLine& line = lines_[near.line[0]];
    const Eigen::Vector2d from_middle = Eigen::Vector2d(event.u_px, event.v_px) - line.PointAt(0.5);
    if (from_middle.norm() >= options_.midpoint_ratio * line.length_px) continue;
    events_.push_back({event.bx, event.by, near.line[0]});
  }
}

void StaticEstimator::Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) {
  constexpr size_t kMinFitEvents = 12;  // twice the number of unknowns
  fit.Clear();
  fit.state = predicted;
  Associate(predicted, input, gate_factor);
  fit.num_gated = static_cast<double>(events_.size());
  if (events_.size() < kMinFitEvents) return;
  // If the events do not determine the pose, the prediction is kept.
  const absl::StatusOr<LineFit> pose =
      FitPoseToLines(camera_, ends_, events_, predicted.camera_from_object, fit_options_);
  if (!pose.ok()) return;

  for (const double weight : pose->weights) fit.num_explained += weight;
  fit.residual_rms_px = pose->residual_rms_px;
  fit.state.camera_from_object = pose->camera_from_object;
  fit.state.covariance.setZero();
  fit.state.covariance.topLeftCorner<6, 6>() = pose->covariance;
  // Twist from the last two poses: the paper's model of constant velocity (LOPET, Sec. III-C).
  const double dt = has_last_ ? static_cast<double>(fit.state.t_us - last_.t_us) * 1e-6 : 0.0;
  if (dt > 0.0) fit.state.twist = Difference(fit.state.camera_from_object, last_.camera_from_object) / dt;
}

}  // namespace

std::unique_ptr<WindowEstimator> MakeStaticEstimator(LineFitMethod method, LineFitFormulas formulas,
                                                     const CameraModel& camera) {
  return std::make_unique<StaticEstimator>(method, formulas, camera);
}

}  // namespace evpose
