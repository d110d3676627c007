#include "core/tracking/tracker.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/tracking/estimator.h"
#include "core/tracking/health.h"
#include "core/tracking/tracker_options.h"
#include "core/tracking/visible_lines.h"

namespace evpose {
namespace {

// Lines that must be supported: three determine six unknowns, and two still bind all but a little of the motion.
constexpr int kConfirmLines = 3;
constexpr int kKeepLines = 2;

class WindowTracker : public Tracker {
 public:
  WindowTracker(std::shared_ptr<const ObjectModel> model, const CameraModel& camera, UndistortionTable undistortion,
                const TrackerOptions& options, const std::optional<RigidTransform>& initial)
      : model_(std::move(model)),
        camera_(camera),
        undistortion_(std::move(undistortion)),
        options_(options),
        windower_(options.windows),
        visible_lines_(*model_, camera, options.visibility),
        grid_(camera),
        estimator_(options.estimator == Estimator::kStaticMm ? MakeStaticMmEstimator(options, camera)
                                                             : MakeMixtureEstimator(options, camera)),
        health_(options.health, options.mixture.min_events_per_px2, static_cast<int>(model_->lines.size())),
        given_pose_(initial) {}

  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) override {
    windower_.Add(events, [&](const EventWindow& window) { OnWindow(window, estimates); });
  }
  void AdvanceTime(int64_t t_us, std::vector<PoseEstimate>& estimates) override {
    windower_.AdvanceTime(t_us, [&](const EventWindow& window) { OnWindow(window, estimates); });
  }
  void Finish(std::vector<PoseEstimate>& estimates) override {
    windower_.Finish([&](const EventWindow& window) { OnWindow(window, estimates); });
    // The events are over, and never spoke for the pose that was given.
    if (state_ == TrackState::kInitializing && has_pose()) Lose();
  }
  void ResetPose(const RigidTransform& camera_from_object) override {
    given_pose_ = camera_from_object;
    given_at_us_ = windower_.now_us();
    tracked_ = false;
    state_ = TrackState::kInitializing;
  }
  TrackState state() const override { return state_; }
  InitializationReport initialization() const override { return {}; }
  uint32_t losses() const override { return losses_; }

 private:
  bool has_pose() const { return tracked_ || given_pose_.has_value(); }
  void OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates);
  void StartFromGivenPose(const EventWindow& window);
  // Turns the window's events near the lines at `predicted` into observations.
  WindowInput Gather(const EventWindow& window, const MotionState& predicted, double gate_factor);
  WindowFit FitWindow(const EventWindow& window, WindowInput& input);
  void UpdateState(const HealthVerdict& verdict, int64_t t_us);
  void Lose();
  Matrix6d PublishedCovariance(const MotionState& state) const;
  PoseEstimate MakeEstimate(const WindowFit& fit, const WindowInput& input) const;

  const std::shared_ptr<const ObjectModel> model_;
  const CameraModel camera_;
  const UndistortionTable undistortion_;
  const TrackerOptions options_;
  EventWindower windower_;
  VisibleLines visible_lines_;
  TileGrid grid_;
  std::unique_ptr<WindowEstimator> estimator_;
  TrackHealth health_;

  TrackState state_ = TrackState::kInitializing;
  uint32_t losses_ = 0;
  std::optional<RigidTransform> given_pose_;
  std::optional<int64_t> given_at_us_;
  bool tracked_ = false;  // motion_ holds a state
  MotionState motion_;
  double usual_explained_ratio_ = 0.0;  // running mean
  int unconfirmed_verdicts_ = 0;
  int64_t supported_at_us_ = 0;  // the last verdict for the pose
  int64_t unsupported_since_us_ = 0;
  bool unsupported_ = false;

  std::vector<ImageLine> image_lines_;
  std::vector<Observation> observations_;
};

void WindowTracker::StartFromGivenPose(const EventWindow& window) {
  const RigidTransform pose = *std::exchange(given_pose_, std::nullopt);
  const int64_t t_us = std::min(given_at_us_.value_or(window.t_begin_us), window.t_mid_us());
  tracked_ = true;
  motion_ = InitialMotionState(pose, t_us, std::max(camera_.fx_px, camera_.fy_px), options_.initial);
  estimator_->Reset();
  health_.Reset();
  usual_explained_ratio_ = 0.0;
  unconfirmed_verdicts_ = 0;
  unsupported_ = false;
}

void WindowTracker::OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
  if (state_ == TrackState::kLost || !has_pose()) return;
  if (!tracked_) StartFromGivenPose(window);

  WindowInput input;
  const WindowFit fit = FitWindow(window, input);
  const bool usable = !input.lines.empty() && fit.state.covariance.allFinite() &&
                      fit.state.camera_from_object.translation_m.allFinite() && fit.state.twist.allFinite();
  if (!usable) return Lose();
  motion_ = fit.state;

  ProjectLines(camera_, motion_, input.lines, image_lines_);
  if (PredictedSpreadPx(camera_, motion_, image_lines_) > options_.health.max_uncertainty_px) return Lose();
  const double events_per_px =
      static_cast<double>(window.num_events) / (static_cast<double>(camera_.width_px) * camera_.height_px);
  health_.AddWindow(camera_, input, image_lines_, motion_.twist, events_per_px);
  const bool confirming = state_ == TrackState::kInitializing;
  const double support = confirming ? options_.health.confirm_support_ratio : options_.health.keep_support_ratio;
  const int64_t patience_us = confirming ? options_.health.min_span_us : options_.health.patience_us;
  UpdateState(health_.Judge(support, confirming ? kConfirmLines : kKeepLines, patience_us), window.t_end_us);
  if (state_ == TrackState::kTracking || state_ == TrackState::kDegraded) {
    estimates.push_back(MakeEstimate(fit, input));
  }
}

WindowFit WindowTracker::FitWindow(const EventWindow& window, WindowInput& input) {
  constexpr double kFallenRatio = 0.6;  // of the running mean: method.md 2.10 (4)
  constexpr double kMinRetryEvents = 50.0;
  constexpr double kForget = 0.05;  // the mean is over about 20 windows
  const MotionState predicted = Predict(motion_, window.t_mid_us(), options_.motion);
  input = Gather(window, predicted, 1.0);
  if (input.lines.empty()) return WindowFit();
  WindowFit fit = estimator_->Fit(predicted, input, 1.0);
  if (fit.num_gated >= kMinRetryEvents && fit.explained_ratio() < kFallenRatio * usual_explained_ratio_) {
    const MotionState agile = Predict(motion_, window.t_mid_us(), options_.motion, options_.motion.retry_noise_factor);
    const WindowInput wide_input = Gather(window, agile, options_.mixture.retry_gate_factor);
    const WindowFit wide = estimator_->Fit(agile, wide_input, options_.mixture.retry_gate_factor);
    input = wide_input;
    if (wide.explained_ratio() <= fit.explained_ratio()) return fit;
    fit = wide;
  }
  estimator_->Accept(fit, input);
  if (fit.num_gated >= kMinRetryEvents) {
    usual_explained_ratio_ +=
        (usual_explained_ratio_ == 0.0 ? 1.0 : kForget) * (fit.explained_ratio() - usual_explained_ratio_);
  }
  return fit;
}

WindowInput WindowTracker::Gather(const EventWindow& window, const MotionState& predicted, double gate_factor) {
  WindowInput input;
  input.duration_s = static_cast<double>(window.t_end_us - window.t_begin_us) * 1e-6;
  input.lines = visible_lines_.At(predicted.camera_from_object);
  input.grid = &grid_;
  ProjectLines(camera_, predicted, input.lines, image_lines_);
  const double spread_px = PredictedSpreadPx(camera_, predicted, image_lines_);
  double motion_px = 0.0;
  for (const ImageLine& line : image_lines_) {
    if (!line.in_view()) continue;
    const double speed = std::abs(BearingOf(camera_, line.PointAt(0.5)).dot(line.a_dot));
    motion_px = std::max(motion_px, 0.5 * speed * input.duration_s);
  }
  const double reach_px = std::max(estimator_->ReachPx(spread_px, gate_factor), TrackHealth::ReachPx(options_.health));
  // Farther lines than this are beyond any gate's use; the bound keeps the work bounded.
  constexpr double kMaxReachPx = 128.0;
  grid_.Build(image_lines_, std::min(reach_px + motion_px, kMaxReachPx));

  observations_.clear();
  for (const Event& event : window.events) {
    if (event.x >= camera_.width_px || event.y >= camera_.height_px) continue;
    const Eigen::Vector2f& bearing = undistortion_.Bearing(event.x, event.y);
    Observation observation;
    observation.bx = bearing.x();
    observation.by = bearing.y();
    observation.u_px = camera_.fx_px * observation.bx + camera_.cx_px;
    observation.v_px = camera_.fy_px * observation.by + camera_.cy_px;
    observation.tile = grid_.TileOf(observation.u_px, observation.v_px);
    if (observation.tile == TileGrid::kNoTile || grid_.Lines(observation.tile).empty()) continue;
    observation.tau_s = static_cast<double>(event.t_us - predicted.t_us) * 1e-6;
    observation.polarity = event.polarity != 0 ? 1 : 0;
    observations_.push_back(observation);
  }
  const size_t found = observations_.size();
  ThinEvenly(static_cast<size_t>(estimator_->MaxEvents()), observations_);
  input.events = observations_;
  input.events_per_observation = window.events_per_sample();
  if (!observations_.empty()) {
    input.events_per_observation *= static_cast<double>(found) / static_cast<double>(observations_.size());
  }
  return input;
}

void WindowTracker::UpdateState(const HealthVerdict& verdict, int64_t t_us) {
  switch (verdict.kind) {
    case HealthVerdict::Kind::kOpen:
      return;
    case HealthVerdict::Kind::kSupported:
      state_ = TrackState::kTracking;
      unsupported_ = false;
      supported_at_us_ = t_us;
      return;
    case HealthVerdict::Kind::kFewEvents:
      // No events, no evidence either way: a still object makes none. But when the pose was already in doubt, as that
      // of an object that is being covered, the silence does not speak for it.
      if (state_ == TrackState::kTracking) state_ = TrackState::kDegraded;
      break;
    case HealthVerdict::Kind::kUnsupported:
      if (state_ == TrackState::kInitializing) {
        if (++unconfirmed_verdicts_ >= options_.health.max_unconfirmed_verdicts) Lose();
        return;
      }
      state_ = TrackState::kDegraded;
      if (!unsupported_) unsupported_since_us_ = t_us;
      unsupported_ = true;
      break;
  }
  if (unsupported_ && t_us - unsupported_since_us_ >= options_.health.lost_after_us) Lose();
}

void WindowTracker::Lose() {
  state_ = TrackState::kLost;
  tracked_ = false;
  given_pose_.reset();
  ++losses_;
}

// While the events do not speak for the pose, the fit's own covariance is that of a wrong association: small, and no
// sign of health (method.md 2.9). What is known then is the last supported state and how far an object may have got
// since.
Matrix6d WindowTracker::PublishedCovariance(const MotionState& state) const {
  if (!unsupported_) return state.covariance.topLeftCorner<6, 6>();
  const int64_t since_us = std::max<int64_t>(0, state.t_us - supported_at_us_);
  const MotionState grown = Predict(state, state.t_us + since_us, options_.motion, options_.motion.retry_noise_factor);
  return grown.covariance.topLeftCorner<6, 6>();
}

PoseEstimate WindowTracker::MakeEstimate(const WindowFit& fit, const WindowInput& input) const {
  PoseEstimate estimate;
  estimate.t_us = fit.state.t_us;
  estimate.camera_from_object = fit.state.camera_from_object;
  estimate.covariance = PublishedCovariance(fit.state);
  estimate.twist = fit.state.twist;
  estimate.state = state_;
  estimate.num_events = static_cast<uint32_t>(std::lround(fit.num_gated * input.events_per_observation));
  estimate.explained_ratio = static_cast<float>(fit.explained_ratio());
  estimate.residual_rms_px = static_cast<float>(fit.residual_rms_px);
  return estimate;
}

absl::Status CheckModel(const ObjectModel* model) {
  if (model == nullptr) return absl::InvalidArgumentError("the tracker needs a model");
  if (model->lines.empty()) return absl::InvalidArgumentError("the model has no line: there is nothing to track");
  // Tiles number lines with 16 bits, and a line may be visible in several parts.
  constexpr size_t kMaxLines = 4096;
  if (model->lines.size() > kMaxLines) {
    return absl::InvalidArgumentError(
        absl::StrCat("the model has ", model->lines.size(), " lines; at most ", kMaxLines, " can be tracked"));
  }
  for (size_t k = 0; k < model->lines.size(); ++k) {
    if (!model->lines[k].p1.allFinite() || !model->lines[k].p2.allFinite()) {
      return absl::InvalidArgumentError(absl::StrCat("model line ", k, " has an end point that is not finite"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

std::string_view TrackStateName(TrackState state) {
  switch (state) {
    case TrackState::kInitializing:
      return "INITIALIZING";
    case TrackState::kTracking:
      return "TRACKING";
    case TrackState::kDegraded:
      return "DEGRADED";
    case TrackState::kLost:
      return "LOST";
  }
  return "UNKNOWN";
}

std::string_view InitializationStatusName(InitializationStatus status) {
  switch (status) {
    case InitializationStatus::kNotNeeded:
      return "NOT_NEEDED";
    case InitializationStatus::kWaitingForEvents:
      return "WAITING_FOR_EVENTS";
    case InitializationStatus::kTooFewLines:
      return "TOO_FEW_LINES";
    case InitializationStatus::kNoPoseFits:
      return "NO_POSE_FITS";
    case InitializationStatus::kVerifying:
      return "VERIFYING";
    case InitializationStatus::kAmbiguous:
      return "AMBIGUOUS";
  }
  return "UNKNOWN";
}

absl::StatusOr<std::unique_ptr<Tracker>> Tracker::Create(
    std::shared_ptr<const ObjectModel> model, const CameraModel& camera, const TrackerOptions& options,
    const std::optional<RigidTransform>& initial_camera_from_object) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckModel(model.get()));
  if (initial_camera_from_object &&
      !(initial_camera_from_object->rotation.allFinite() && initial_camera_from_object->translation_m.allFinite() &&
        initial_camera_from_object->translation_m.norm() > 1e-9)) {
    return absl::InvalidArgumentError("initial_camera_from_object must be finite, and away from the camera's centre");
  }
  EVPOSE_ASSIGN_OR_RETURN(UndistortionTable undistortion, UndistortionTable::Create(camera));
  return std::make_unique<WindowTracker>(std::move(model), camera, std::move(undistortion), options,
                                         initial_camera_from_object);
}

}  // namespace evpose
