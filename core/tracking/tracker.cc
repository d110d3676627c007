// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/tracker.h"

#include <algorithm>
#include <array>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/association/other_objects.h"
#include "core/association/visible_edges.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/detection/plane_detector.h"
#include "core/initialization/check_lines.h"
#include "core/initialization/initializer.h"
#include "core/initialization/pose_search.h"
#include "core/initialization/search_model.h"
#include "core/initialization/templates/template_model.h"
#include "core/tracking/object/object_tracker.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/view_tracker.h"

namespace evpose {
namespace {

class WindowTracker : public Tracker {
 public:
  WindowTracker(const WindowOptions& options, const SensorGeometry& sensor,
                std::vector<std::unique_ptr<ObjectTracker>> objects)
      : windower_(options, sensor), objects_(std::move(objects)) {}
  WindowTracker(const WindowTracker&) = delete;
  WindowTracker& operator=(const WindowTracker&) = delete;
  ~WindowTracker() override {
    for (auto& object : objects_) {
      YieldPointOfDestructor();
      object.reset();
    }
  }

  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) override {
    windower_.Add(events, [&](const EventWindow& window) { OnWindow(window, estimates); });
  }
  void AdvanceTime(int64_t t_us, std::vector<PoseEstimate>& estimates) override {
    windower_.AdvanceTime(t_us, [&](const EventWindow& window) { OnWindow(window, estimates); });
  }
  EventGap Skip(absl::Span<const Event> events, int64_t t_us) override {
    const EventGap gap = windower_.Skip(events, t_us);
    for (const auto& object : objects_) object->OnGap(gap);
    return gap;
  }
  void Finish(std::vector<PoseEstimate>& estimates) override {
    windower_.Finish([&](const EventWindow& window) { OnWindow(window, estimates); });
    for (const auto& object : objects_) object->Finish();
  }
  void ResetPose(size_t object_index, const RigidTransform& camera_from_object) override {
    objects_[object_index]->ResetPose(
        camera_from_object, windower_.has_started() ? std::optional<int64_t>(windower_.now_us()) : std::nullopt);
  }
  void SetPhaseListener(const PhaseListener& listener) override {
    for (const auto& object : objects_) object->SetPhaseListener(listener);
  }
  size_t num_objects() const override { return objects_.size(); }
  TrackState state(size_t object_index) const override { return objects_[object_index]->state(); }
  InitializationReport initialization(size_t object_index) const override {
    return objects_[object_index]->initialization();
  }
  uint32_t losses(size_t object_index) const override { return objects_[object_index]->losses(); }
  bool Outline(size_t object_index, ObjectOutline& outline) const override {
    return objects_[object_index]->Outline(outline);
  }
  void SaveState(StateWriter& writer) const override { VisitState(writer, *this); }
  void LoadState(StateReader& reader) override { VisitState(reader, *this); }

 private:
  static void VisitState(auto& archive, auto& self) {
    auto& [windower, objects] = self;
    archive(windower);
    for (const auto& object : objects) {
      YieldPoint();
      archive(*object);
    }
  }

  void OnWindow(const EventWindow& window, std::vector<PoseEstimate>& estimates) {
    for (const auto& object : objects_) object->BeginWindow();
    for (size_t i = 0; i < objects_.size(); ++i) {
      YieldPoint();
      const size_t first = estimates.size();
      objects_[i]->OnWindow(window, estimates);
      for (size_t k = first; k < estimates.size(); ++k) estimates[k].object_index = static_cast<uint32_t>(i);
    }
    double speed_px_per_s = 0.0;
    for (const auto& object : objects_) speed_px_per_s = std::max(speed_px_per_s, object->ImageSpeedPxPerS());
    windower_.SetImageSpeed(speed_px_per_s);
  }

  EventWindower windower_;
  std::vector<std::unique_ptr<ObjectTracker>> objects_;
};

absl::StatusOr<std::vector<std::shared_ptr<LineDetector>>> MakeDetectors(const InitializationOptions& options,
                                                                         SensorGeometry sensor) {
  std::vector<std::shared_ptr<LineDetector>> detectors;
  if (options.detector_factory) {
    EVPOSE_ASSIGN_OR_RETURN(detectors.emplace_back(), options.detector_factory(sensor));
    return detectors;
  }
  for (const PlaneDetectorOptions& of_detector : PlaneDetectorOptions::ForSearch(sensor)) {
    EVPOSE_ASSIGN_OR_RETURN(detectors.emplace_back(), MakePlaneLineDetector(of_detector, sensor));
  }
  return detectors;
}

// Whether the object is searched for by its lines. True for a model that has neither enough lines nor curves: its
// search reports why it cannot be found.
bool IsSearchedByLines(const ObjectModel& model) { return IsSearchable(model) || !HasCurvedEdges(model); }

// Computes what depends on the model alone and was not given.
absl::Status AddModelTables(const TrackerOptions& options, ObjectToTrack& object) {
  if (object.edges == nullptr) object.edges = MakeModelEdges(object.model, options.visibility, options.elements);
  if (!options.initialization.is_automatic) return absl::OkStatus();
  if (object.search_model == nullptr && IsSearchedByLines(*object.model)) {
    EVPOSE_ASSIGN_OR_RETURN(object.search_model, MakeSearchModel(object.model));
  }
  if (object.template_model == nullptr && HasCurvedEdges(*object.model)) {
    object.template_model = std::make_shared<const TemplateModel>(object.model, object.edges->surface());
  }
  return absl::OkStatus();
}

// Returns null for a model that is tracked from given poses only, because no edge is visible in its views.
absl::StatusOr<std::unique_ptr<PoseInitializer>> MakeInitializer(const ObjectToTrack& object, const CameraModel& camera,
                                                                 std::vector<std::shared_ptr<LineDetector>> detectors) {
  std::unique_ptr<PoseSearch> search;
  if (IsSearchedByLines(*object.model)) {
    EVPOSE_ASSIGN_OR_RETURN(search, MakePoseSearch(object.model, camera, {}, object.search_model));
  }
  std::unique_ptr<TemplateSearch> templates;
  if (HasCurvedEdges(*object.model) && object.template_model->num_coarse() > 0) {
    templates = std::make_unique<TemplateSearch>(object.template_model, camera);
  }
  if (search == nullptr && templates == nullptr) return std::unique_ptr<PoseInitializer>();
  return std::make_unique<PoseInitializer>(object.model, camera, std::move(detectors), std::move(search),
                                           std::move(templates));
}

}  // namespace

absl::StatusOr<std::unique_ptr<Tracker>> Tracker::Create(std::vector<ObjectToTrack> objects, const CameraModel& camera,
                                                         const TrackerOptions& options,
                                                         std::shared_ptr<const CameraTables> tables) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  if (objects.empty()) return absl::InvalidArgumentError("objects must not be empty");
  for (size_t i = 0; i < objects.size(); ++i) {
    const absl::Status status = objects[i].Validate();
    if (!status.ok()) return absl::Status(status.code(), absl::StrCat("objects[", i, "]: ", status.message()));
  }
  if (tables == nullptr) {
    EVPOSE_ASSIGN_OR_RETURN(tables, MakeCameraTables(camera));
  }
  for (ObjectToTrack& object : objects) EVPOSE_RETURN_IF_ERROR(AddModelTables(options, object));
  if (camera.lens_model == LensModel::kFisheye) {
    return MakeViewTracker(std::move(objects), camera, options, tables->undistortion);
  }
  const SensorGeometry sensor = {camera.width_px, camera.height_px};
  // All objects share these detectors, because they search one after the other.
  std::vector<std::shared_ptr<LineDetector>> detectors;
  if (options.initialization.is_automatic) {
    EVPOSE_ASSIGN_OR_RETURN(detectors, MakeDetectors(options.initialization, sensor));
  }
  std::vector<std::unique_ptr<ObjectTracker>> trackers;
  for (const ObjectToTrack& object : objects) {
    std::unique_ptr<PoseInitializer> initializer;
    if (!detectors.empty()) {
      EVPOSE_ASSIGN_OR_RETURN(initializer, MakeInitializer(object, camera, detectors));
    }
    TrackContext context{object.model, camera, tables, options, object.edges};
    context.phase_reporter->object_index = static_cast<uint32_t>(trackers.size());
    trackers.push_back(std::make_unique<ObjectTracker>(std::move(context), std::move(initializer), object));
  }
  for (const auto& tracker : trackers) {
    std::vector<const ObjectTracker*> others;
    for (const auto& other : trackers) {
      if (other != tracker) others.push_back(other.get());
    }
    tracker->SetOthers(std::move(others));
  }
  return std::make_unique<WindowTracker>(options.windows, sensor, std::move(trackers));
}

absl::StatusOr<std::unique_ptr<Tracker>> Tracker::Create(
    std::shared_ptr<const ObjectModel> model, const CameraModel& camera, const TrackerOptions& options,
    const std::optional<RigidTransform>& initial_camera_from_object) {
  ObjectToTrack object;
  object.model = std::move(model);
  object.initial_camera_from_object = initial_camera_from_object;
  return Create({std::move(object)}, camera, options);
}

}  // namespace evpose
