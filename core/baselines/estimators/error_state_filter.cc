// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/estimators/error_state_filter.h"

#include <cmath>
#include <vector>

namespace evpose {
namespace {

class ErrorStateFilter : public WindowEstimator {
 public:
  explicit ErrorStateFilter(const CameraModel& camera) : camera_(camera) {}

  double ReachPx(double, double gate_factor) const override {
    // The lines may move by up to one gate while the events of the window are processed.
    return 2.0 * options_.gate_px * gate_factor;
  }
  int MaxEvents() const override { return options_.max_events; }
  void Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) override;
  // The filter has no memory apart from the motion state.
  void Accept(const WindowFit&, const WindowInput&) override {}
  void SaveState(StateWriter&) const override {}
  void LoadState(StateReader&) override {}

 private:
  // Processes one event: association, test, update.
  void Take(const Observation& event, double gate_factor, ErrorState& error, WindowFit& fit) const;

  const ErrorStateFilterOptions options_ = {};
  const CameraModel camera_;
  std::vector<ImageLine> lines_;
};

void ErrorStateFilter::Take(const Observation& event, double gate_factor, ErrorState& error, WindowFit& fit) const {
  const NearLines near = FindNearLines(event, lines_.data(), options_.gate_px * gate_factor, 0.0);
  if (near.count == 0) return;
  if (near.count == 2 && std::abs(near.distance_px[1]) < options_.two_lines_px) return;
  fit.num_gated += 1.0;
  // The state is that of mid-window; the twist relates it to the time of the event.
  const Vector6d pose_row = lines_[near.line[0]].jacobian.transpose() * Eigen::Vector3d(event.bx, event.by, 1.0);
  Vector12d row;
  row << pose_row, event.tau_s * pose_row;
  const double expected_px = error.ExpectedPx(near.distance_px[0], row);
  const double noise_px2 = options_.sigma_px * options_.sigma_px;
  if (expected_px * expected_px > options_.gate_chi2 * (error.VariancePx2(row) + noise_px2)) return;
  fit.num_explained += 1.0;
  fit.residual_rms_px += expected_px * expected_px;
  error.Update(near.distance_px[0], row, noise_px2 * options_.events_per_information);
}

void ErrorStateFilter::Fit(const MotionState& predicted, const WindowInput& input, double gate_factor, WindowFit& fit) {
  fit.Clear();
  ErrorState error(predicted);
  ProjectLines(camera_, predicted, input.lines, lines_);
  double lines_of_s = input.events.empty() ? 0.0 : input.events.front().tau_s;
  for (const Observation& event : input.events) {
    if (event.tau_s - lines_of_s >= options_.injection_s) {
      error.Inject();
      ProjectLines(camera_, error.state(), input.lines, lines_);
      lines_of_s = event.tau_s;
    }
    Take(event, gate_factor, error, fit);
  }
  error.Inject();
  fit.state = error.state();
  if (fit.num_explained > 0.0) fit.residual_rms_px = std::sqrt(fit.residual_rms_px / fit.num_explained);
}

}  // namespace

void ErrorState::Update(double distance_px, const Vector12d& row, double noise_px2) {
  const Vector12d covariance_row = state_.covariance * row;
  const Vector12d gain = covariance_row / (row.dot(covariance_row) + noise_px2);
  error_ -= ExpectedPx(distance_px, row) * gain;
  state_.covariance -= gain * covariance_row.transpose();
}

void ErrorState::Inject() {
  state_ = Plus(state_, error_);
  error_.setZero();
  // Rounding would make the covariance asymmetric in the course of many updates.
  state_.covariance = (0.5 * (state_.covariance + state_.covariance.transpose())).eval();
}

std::unique_ptr<WindowEstimator> MakeErrorStateFilter(const CameraModel& camera) {
  return std::make_unique<ErrorStateFilter>(camera);
}

}  // namespace evpose
