// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/simulator.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/simulation/motion.h"
#include "core/simulation/objects.h"
#include "core/simulation/renderer.h"

namespace evpose {
namespace {

constexpr int64_t kClockWrapUs = int64_t{1} << 24;  // period of the 24-bit clock of EVT3
constexpr int64_t kMaxDurationUs = 1'800'000'000;   // half an hour: times of pixels stay below 2^31 microseconds
constexpr int64_t kTruthStepUs = 1000;              // the interpolation error of the truth is then micrometres at most
constexpr size_t kBatchEvents = 1 << 16;            // events per delivery, about 1 MB
// Factor by which a step that moves the image too far is shortened below the proportional length, so that the next
// attempt usually succeeds.
constexpr double kStepSafety = 0.95;

// Independent random streams from one seed.
constexpr uint64_t kMotionStream = 0x6d6f74696f6eULL;
constexpr uint64_t kAttitudeStream = 0x6174746974756465ULL;
constexpr uint64_t kTextureStream = 0x74657874757265ULL;
constexpr uint64_t kSensorStream = 0x73656e736f72ULL;

uint64_t PathSeed(const SimulationOptions& options) { return options.path_seed.value_or(options.seed); }

SceneObject MakeObject(const SimulationOptions& options) {
  const SceneOptions& scene = options.scene;
  if (scene.model != nullptr) {
    SceneObject object = MakeModelObject(*scene.model, PathSeed(options) ^ kAttitudeStream);
    if (scene.shows_front) object.view_from_object = Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
    return object;
  }
  return MakeSceneObject(scene.object, scene.object_size_m);
}

// The motion of the object's frame, of which the path is that of its centre.
class ObjectPath {
 public:
  static absl::StatusOr<ObjectPath> Create(const SimulationOptions& options, const SceneObject& object) {
    EVPOSE_ASSIGN_OR_RETURN(MotionPath path,
                            MotionPath::Create(options.scene.motion, options.camera, object.radius_m,
                                               object.view_from_object, PathSeed(options) ^ kMotionStream));
    return ObjectPath(std::move(path), object.centre_m);
  }

  RigidTransform CameraFromObject(double t_s) const {
    RigidTransform pose = path_.CameraFromObject(t_s);
    pose.translation_m -= pose.rotation * centre_m_;
    return pose;
  }

 private:
  ObjectPath(MotionPath path, const Eigen::Vector3d& centre_m) : path_(std::move(path)), centre_m_(centre_m) {}

  MotionPath path_;
  Eigen::Vector3d centre_m_;
};

double Seconds(int64_t t_us) { return static_cast<double>(t_us) * 1e-6; }

// The end of a step of the simulation.
struct Step {
  int64_t end_us;
  RigidTransform pose;
  double motion_px;
};

// Returns the longest step from t_us on in which the image moves by at most max_step_px, and at most twice as long as
// the last step.
Step ChooseStep(const SimulationOptions& options, const ObjectPath& path, const SceneRenderer& renderer, int64_t t_us,
                const RigidTransform& pose, int64_t last_length_us) {
  const auto longest_us = static_cast<int64_t>(renderer.LongestStepS() * 1e6);
  int64_t length_us = std::clamp<int64_t>(2 * last_length_us, 1, longest_us);
  while (true) {
    length_us = std::min(length_us, options.duration_us - t_us);
    const int64_t end_us = t_us + length_us;
    const RigidTransform end_pose = path.CameraFromObject(Seconds(end_us));
    const double motion_px = renderer.LargestMotionPx(pose, Seconds(t_us), end_pose, Seconds(end_us));
    if (motion_px <= options.max_step_px || length_us == 1) return {end_us, end_pose, motion_px};
    const double shrink = kStepSafety * options.max_step_px / motion_px;
    length_us = std::clamp<int64_t>(static_cast<int64_t>(static_cast<double>(length_us) * shrink), 1, length_us - 1);
  }
}

}  // namespace

absl::Status SimulationOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(scene.Validate());
  EVPOSE_RETURN_IF_ERROR(sensor.Validate());
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("SimulationOptions.t_begin_us", static_cast<double>(t_begin_us), 0,
                                    static_cast<double>(kClockWrapUs), OpenEnds::kHigh));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SimulationOptions.duration_us", static_cast<double>(duration_us), 1,
                                    static_cast<double>(kMaxDurationUs)));
  EVPOSE_RETURN_IF_ERROR(CheckRange("SimulationOptions.max_step_px", max_step_px, 0.01, 1.0));
  constexpr int kMaxSidePx = 2048;  // the address range of EVT3
  if (camera.width_px > kMaxSidePx || camera.height_px > kMaxSidePx) {
    return absl::InvalidArgumentError(absl::StrFormat("SimulationOptions.camera is %dx%d; EVT3 addresses %dx%d at most",
                                                      camera.width_px, camera.height_px, kMaxSidePx, kMaxSidePx));
  }
  return ObjectPath::Create(*this, MakeObject(*this)).status();
}

absl::StatusOr<SimulationReport> Simulate(const SimulationOptions& options,
                                          const std::function<absl::Status(absl::Span<const Event>)>& on_events,
                                          const std::function<void(double progress_ratio)>& on_progress) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  const SceneObject object = MakeObject(options);
  EVPOSE_ASSIGN_OR_RETURN(const ObjectPath path, ObjectPath::Create(options, object));
  SceneRenderer renderer(options.scene, object, options.camera, options.seed ^ kTextureStream);
  RigidTransform pose = path.CameraFromObject(0.0);
  renderer.Render(pose, 0.0);
  EventSensor sensor(options.sensor, {options.camera.width_px, options.camera.height_px}, renderer.picture(),
                     options.seed ^ kSensorStream);
  SimulationReport report;
  report.rendered_frames = 1;
  std::vector<Event> batch;
  const auto deliver = [&]() -> absl::Status {
    for (Event& event : batch) event.t_us += options.t_begin_us;
    absl::Status status = batch.empty() ? absl::OkStatus() : on_events(batch);
    batch.clear();
    return status;
  };
  int64_t t_us = 0;
  int64_t length_us = 1;
  int last_percent = 0;
  while (t_us < options.duration_us) {
    const Step step = ChooseStep(options, path, renderer, t_us, pose, length_us);
    length_us = step.end_us - t_us;
    t_us = step.end_us;
    pose = step.pose;
    report.max_speed_px_per_s = std::max(report.max_speed_px_per_s, step.motion_px / Seconds(length_us));
    const PixelRect changed = renderer.Render(pose, Seconds(t_us));
    ++report.rendered_frames;
    sensor.Advance(t_us, renderer.picture(), changed, batch);
    if (batch.size() >= kBatchEvents) EVPOSE_RETURN_IF_ERROR(deliver());
    const int percent = static_cast<int>(100 * t_us / options.duration_us);
    if (on_progress != nullptr && percent != last_percent) on_progress(percent / 100.0);
    last_percent = percent;
  }
  EVPOSE_RETURN_IF_ERROR(deliver());
  static_cast<SensorCounts&>(report) = sensor.counts();
  return report;
}

Trajectory SimulatedTruth(const SimulationOptions& options) {
  Trajectory truth;
  if (!options.Validate().ok()) return truth;
  const absl::StatusOr<ObjectPath> path = ObjectPath::Create(options, MakeObject(options));
  for (int64_t t_us = 0; t_us <= options.duration_us; t_us += kTruthStepUs) {
    truth.push_back({options.t_begin_us + t_us, path->CameraFromObject(Seconds(t_us))});
  }
  if (truth.back().t_us < options.t_begin_us + options.duration_us) {
    truth.push_back({options.t_begin_us + options.duration_us, path->CameraFromObject(Seconds(options.duration_us))});
  }
  return truth;
}

absl::StatusOr<ObjectModel> SimulatedModel(const SimulationOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  return options.scene.model != nullptr ? *options.scene.model : MakeObject(options).model;
}

}  // namespace evpose
