// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_oracle.h"

#include <Eigen/Eigenvalues>
#include <optional>
#include <utility>

#include "core/base/status_macros.h"
#include "core/geometry/motion_prior.h"
#include "core/tracking/object/pose_track.h"
#include "core/windows/event_window.h"

namespace evpose {
namespace {

// Whether the events and not the true start determine the pose: in no direction is more than a quarter of the variance
// of the prior left.
bool IsFromEvents(const Matrix6d& covariance, const Matrix6d& prior) {
  constexpr double kMostRatio = 0.25;
  const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix6d> solver(covariance, prior, Eigen::EigenvaluesOnly);
  return solver.info() == Eigen::Success && solver.eigenvalues().maxCoeff() <= kMostRatio;
}

class TrackingOracle final : public PoseSource {
 public:
  TrackingOracle(TrackContext context, const Trajectory& truth)
      : context_(std::move(context)),
        truth_(truth),
        windower_(context_.options.windows, {context_.camera.width_px, context_.camera.height_px}) {}

  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) override {
    windower_.Add(events, [&](const EventWindow& window) { OnWindow(window, estimates); });
  }
  void Finish(std::vector<PoseEstimate>& estimates) override {
    windower_.Finish([&](const EventWindow& window) { OnWindow(window, estimates); });
  }

 private:
  void OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
    const std::optional<MotionState> start = StateAt(window.t_mid_us());
    if (!start) return;
    // One track for all windows, which learns the contrast of the lines and the spread of the events as in the tracker.
    if (track_ == nullptr) track_ = std::make_unique<PoseTrack>(context_, *start);
    track_->set_motion(*start);
    track_->OnWindow(window);
    const MotionState& fitted = track_->motion();
    const Matrix6d covariance = fitted.covariance.topLeftCorner<6, 6>();
    if (!IsFromEvents(covariance, start->covariance.topLeftCorner<6, 6>())) return;
    PoseEstimate estimate;
    estimate.t_us = fitted.t_us;
    estimate.camera_from_object = fitted.camera_from_object;
    estimate.covariance = covariance;
    estimate.twist = fitted.twist;
    estimate.state = TrackState::kTracking;
    estimates.push_back(estimate);
  }

  // nullopt outside the interval of the truth.
  std::optional<MotionState> StateAt(int64_t t_us) const {
    constexpr int64_t kHalfStepUs = 500;  // microseconds to both sides: the interval of the true poses is 1 ms
    const absl::StatusOr<RigidTransform> pose = Interpolate(truth_, t_us);
    const absl::StatusOr<RigidTransform> before = Interpolate(truth_, t_us - kHalfStepUs);
    const absl::StatusOr<RigidTransform> after = Interpolate(truth_, t_us + kHalfStepUs);
    if (!pose.ok() || !before.ok() || !after.ok()) return std::nullopt;
    const double focal_px = context_.camera.MaxFocalPx();
    MotionState state = InitialMotionState(*pose, t_us, focal_px, context_.options.initial);
    state.twist = Difference(*after, *before) / (2e-6 * kHalfStepUs);
    return state;
  }

  const TrackContext context_;
  const Trajectory& truth_;
  EventWindower windower_;
  std::unique_ptr<PoseTrack> track_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PoseSource>> MakeTrackingOracle(std::shared_ptr<const ObjectModel> model,
                                                               const CameraModel& camera, const TrackerOptions& options,
                                                               const Trajectory& truth) {
  // Arguments that a tracker rejects are rejected here, too.
  EVPOSE_RETURN_IF_ERROR(Tracker::Create(model, camera, options, std::nullopt).status());
  EVPOSE_ASSIGN_OR_RETURN(auto tables, MakeCameraTables(camera));
  auto edges = std::make_shared<const ModelEdges>(*model, options.visibility, options.elements);
  return std::make_unique<TrackingOracle>(TrackContext{model, camera, std::move(tables), options, std::move(edges)},
                                          truth);
}

}  // namespace evpose
