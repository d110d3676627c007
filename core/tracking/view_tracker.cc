// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/view_tracker.h"

#include <algorithm>
#include <iterator>
#include <optional>
#include <utility>

#include "core/association/camera_tables.h"
#include "core/association/other_objects.h"
#include "core/base/status_macros.h"
#include "core/tracking/lens_views.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {
namespace {

// Time between two decisions about the views. An object at 1000 px/s moves by 5 px meanwhile.
constexpr int64_t kDecisionUs = 5000;
// Difference of the cosines of the angles to the axes of two views from which on the nearer one takes an object over,
// so that an object between two views does not change to and fro: 2 degrees beyond the middle.
constexpr double kTakeOverCosine = 0.015;
// Time, microseconds, for the events to support the pose in the new view, before it is tried again with a later pose.
// At ordinary event rates a right pose is confirmed sooner; after this time the predicted pose is too old.
constexpr int64_t kConfirmUs = 200'000;
constexpr int64_t kNever = -kMaxStateTimeUs;  // its difference from any time of an event does not overflow

struct View {
  LensView lens;
  std::shared_ptr<const CameraTables> tables;
};

bool IsReported(TrackState state) {
  return state == TrackState::kTracking || state == TrackState::kDegraded || state == TrackState::kAmbiguous;
}

RigidTransform Turned(const Eigen::Matrix3d& turn, const RigidTransform& pose) {
  return {turn * pose.rotation, turn * pose.translation_m};
}

// The estimate in the frame of the camera.
PoseEstimate InCamera(const LensView& view, const PoseEstimate& in_view) {
  const Eigen::Matrix3d turn = view.view_from_camera.transpose();
  const Matrix6d jacobian = JacobianOfProduct(turn);
  PoseEstimate estimate = in_view;
  estimate.camera_from_object = Turned(turn, in_view.camera_from_object);
  estimate.covariance = jacobian * in_view.covariance * jacobian.transpose();
  estimate.twist = jacobian * in_view.twist;
  estimate.alternatives = {};
  for (const PoseAlternative& alternative : in_view.alternatives) {
    estimate.alternatives.Add({Turned(turn, alternative.camera_from_object), alternative.log_likelihood_ratio});
  }
  return estimate;
}

// The views in which an object without a pose is searched for. Stored as one byte.
enum class SearchScope : uint8_t {
  kAllViews,
  kReportingView,  // a given pose is being tested there
};

// One object in the views.
class ViewedObject {
 public:
  ViewedObject(ObjectToTrack object, uint32_t index, const std::vector<View>& views, const TrackerOptions& options)
      : object_(std::move(object)),
        centre_(BoundingSphereOf(*object_.model).centre),
        index_(index),
        views_(views),
        options_(options),
        trackers_(views.size()) {}

  absl::Status Start() {
    if (object_.initial_camera_from_object) {
      reporting_view_ = NearestTo(*object_.initial_camera_from_object);
      scope_ = SearchScope::kReportingView;
    }
    return Create(reporting_view_, object_.initial_camera_from_object);
  }

  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) {
    ForEach(estimates,
            [&](Tracker& tracker, std::vector<PoseEstimate>& of_view) { tracker.AddEvents(events, of_view); });
  }
  void AdvanceTime(int64_t t_us, std::vector<PoseEstimate>& estimates) {
    ForEach(estimates,
            [&](Tracker& tracker, std::vector<PoseEstimate>& of_view) { tracker.AdvanceTime(t_us, of_view); });
  }
  void Finish(std::vector<PoseEstimate>& estimates) {
    ForEach(estimates, [](Tracker& tracker, std::vector<PoseEstimate>& of_view) { tracker.Finish(of_view); });
  }
  EventGap Skip(absl::Span<const Event> events, int64_t t_us) {
    EventGap gap = reporting_tracker().Skip(events, t_us);
    for (size_t v = 0; v < views_.size(); ++v) {
      if (trackers_[v] != nullptr && v != reporting_view_) trackers_[v]->Skip(events, t_us);
    }
    return gap;
  }

  // Changes the views in which the object is followed or searched for. To be called between windows, at times that
  // depend on the events alone.
  void Decide(int64_t t_us) {
    const TrackState state = reporting_tracker().state();
    const bool is_reported = IsReported(state);
    if (is_reported || state == TrackState::kLost) scope_ = SearchScope::kAllViews;
    if (is_reported) {
      // A tracker that has just taken over has no estimate before the end of its window.
      if (latest_) Follow(t_us);
    } else if (scope_ == SearchScope::kAllViews && options_.initialization.is_automatic) {
      SearchInViews();
    }
  }

  void ResetPose(const RigidTransform& camera_from_object) {
    past_losses_ = losses();
    std::fill(trackers_.begin(), trackers_.end(), nullptr);
    reporting_view_ = NearestTo(camera_from_object);
    latest_.reset();
    scope_ = SearchScope::kReportingView;
    // Start() has made a tracker of the same object.
    if (!Create(reporting_view_, camera_from_object).ok()) (void)Create(reporting_view_, std::nullopt);
  }

  void SetPhaseListener(const PhaseListener& listener) {
    listener_ = listener;
    for (size_t v = 0; v < views_.size(); ++v) {
      if (trackers_[v] != nullptr) Listen(v);
    }
  }

  Tracker& reporting_tracker() { return *trackers_[reporting_view_]; }
  const Tracker& reporting_tracker() const { return *trackers_[reporting_view_]; }
  uint32_t losses() const { return past_losses_ + reporting_tracker().losses(); }

  // The edges are in the frame of the object, and the pose in that of the camera, as in InCamera().
  bool Outline(ObjectOutline& outline) const {
    if (!reporting_tracker().Outline(0, outline)) return false;
    outline.camera_from_object =
        Turned(views_[reporting_view_].lens.view_from_camera.transpose(), outline.camera_from_object);
    return true;
  }

  void SaveState(StateWriter& writer) const {
    VisitState(writer, *this);
    for (const auto& tracker : trackers_) {
      const bool is_running = tracker != nullptr;
      writer(is_running);
      if (is_running) tracker->SaveState(writer);
    }
  }
  void LoadState(StateReader& reader) {
    VisitState(reader, *this);
    if (!reader.ok()) return;
    reader.Check(reporting_view_ < views_.size(), "a view that the lens does not have");
    reader.Check(!latest_ || latest_->t_us == published_us_, "an estimate that was not published");
    for (size_t v = 0; v < views_.size() && reader.ok(); ++v) {
      bool is_running = false;
      reader(is_running);
      trackers_[v].reset();
      if (!is_running) continue;
      reader.Check(Create(v, std::nullopt).ok(), "a view without a tracker");
      if (trackers_[v] != nullptr) trackers_[v]->LoadState(reader);
    }
    if (reader.ok()) reader.Check(trackers_[reporting_view_] != nullptr, "the view of the object is not tracked");
  }

 private:
  static void VisitState(auto& archive, auto& self) {
    archive(self.reporting_view_, self.past_losses_, AtMost(self.scope_, SearchScope::kReportingView), self.latest_,
            InRange(self.published_us_, kNever, kMaxStateTimeUs), InRange(self.candidate_us_, kNever, kMaxStateTimeUs));
  }

  double CosineTo(size_t view, const RigidTransform& camera_from_object) const {
    return views_[view].lens.view_from_camera.row(2).dot((camera_from_object * centre_).normalized());
  }
  uint32_t NearestTo(const RigidTransform& camera_from_object) const {
    uint32_t nearest = 0;
    for (uint32_t v = 1; v < views_.size(); ++v) {
      if (CosineTo(v, camera_from_object) > CosineTo(nearest, camera_from_object)) nearest = v;
    }
    return nearest;
  }

  absl::Status Create(size_t view, const std::optional<RigidTransform>& camera_from_object) {
    const Eigen::Matrix3d& turn = views_[view].lens.view_from_camera;
    ObjectToTrack object = object_;
    object.reference_rotation = turn * object_.reference_rotation;
    object.initial_camera_from_object.reset();
    if (camera_from_object) object.initial_camera_from_object = Turned(turn, *camera_from_object);
    EVPOSE_ASSIGN_OR_RETURN(
        trackers_[view], Tracker::Create({std::move(object)}, views_[view].lens.camera, options_, views_[view].tables));
    if (listener_) Listen(view);
    return absl::OkStatus();
  }

  // Reports the transitions in the view from which the object is reported.
  void Listen(size_t view) {
    trackers_[view]->SetPhaseListener([this, view](PhaseTransition transition) {
      transition.object_index = index_;
      if (view == reporting_view_ && listener_) listener_(transition);
    });
  }

  template <typename Run>
  void ForEach(std::vector<PoseEstimate>& estimates, const Run& run) {
    for (size_t v = 0; v < views_.size(); ++v) {
      if (trackers_[v] == nullptr) continue;
      of_view_.clear();
      run(*trackers_[v], of_view_);
      if (v == reporting_view_) Publish(estimates);
    }
  }

  void Publish(std::vector<PoseEstimate>& estimates) {
    for (const PoseEstimate& in_view : of_view_) {
      // The windows of two views end at different times.
      if (in_view.t_us <= published_us_) continue;
      PoseEstimate& estimate = estimates.emplace_back(InCamera(views_[reporting_view_].lens, in_view));
      estimate.object_index = index_;
      published_us_ = estimate.t_us;
      latest_ = estimate;
    }
  }

  // Keeps the view from which the object is reported, and the one that takes it over.
  void Follow(int64_t t_us) {
    const RigidTransform& pose = latest_->camera_from_object;
    const uint32_t nearest = NearestTo(pose);
    for (size_t v = 0; v < views_.size(); ++v) {
      if (v != reporting_view_ && v != nearest) trackers_[v].reset();
    }
    if (nearest == reporting_view_) return;
    const Tracker* const candidate = trackers_[nearest].get();
    // A candidate with a loss has rejected the predicted pose: a pose that it finds afterwards is another one.
    if (candidate != nullptr && candidate->losses() == 0) {
      if (candidate->state() == TrackState::kTracking) {
        MoveTo(nearest);
        return;
      }
      if (t_us - candidate_us_ < kConfirmUs) return;
    }
    trackers_[nearest].reset();
    if (CosineTo(nearest, pose) < CosineTo(reporting_view_, pose) + kTakeOverCosine) return;
    const double dt_s = static_cast<double>(t_us - latest_->t_us) * 1e-6;
    candidate_us_ = t_us;
    // Without a tracker in the nearer view, the object stays in the present one.
    (void)Create(nearest, Perturb(pose, dt_s * latest_->twist));
  }

  // Searches in all views until one has found the object.
  void SearchInViews() {
    latest_.reset();
    for (const TrackState wanted : {TrackState::kTracking, TrackState::kDegraded, TrackState::kAmbiguous}) {
      for (uint32_t v = 0; v < views_.size(); ++v) {
        if (v == reporting_view_ || trackers_[v] == nullptr || trackers_[v]->state() != wanted) continue;
        MoveTo(v);
        return;
      }
    }
    for (size_t v = 0; v < views_.size(); ++v) {
      if (trackers_[v] == nullptr && views_[v].lens.is_searched) (void)Create(v, std::nullopt);
    }
  }

  void MoveTo(uint32_t view) {
    past_losses_ += reporting_tracker().losses();
    trackers_[reporting_view_].reset();
    reporting_view_ = view;
  }

  const ObjectToTrack object_;
  const Eigen::Vector3d centre_;  // centre of the object, in its frame
  const uint32_t index_;
  const std::vector<View>& views_;
  const TrackerOptions& options_;
  PhaseListener listener_;
  std::vector<std::unique_ptr<Tracker>> trackers_;  // by view; null: not followed there
  std::vector<PoseEstimate> of_view_;               // estimates of one view, temporary of ForEach()

  uint32_t reporting_view_ = 0;  // the view from which the object is reported
  uint32_t past_losses_ = 0;
  SearchScope scope_ = SearchScope::kAllViews;
  std::optional<PoseEstimate> latest_;  // in the frame of the camera, since the object was found
  int64_t published_us_ = kNever;
  int64_t candidate_us_ = kNever;  // start of the tracker that takes the object over
};

class ViewTracker : public Tracker {
 public:
  ViewTracker(std::vector<View> views, const CameraModel& camera, const TrackerOptions& options)
      : views_(std::move(views)), camera_(camera), options_(options) {}

  absl::Status Add(ObjectToTrack object) {
    const auto index = static_cast<uint32_t>(objects_.size());
    objects_.push_back(std::make_unique<ViewedObject>(std::move(object), index, views_, options_));
    return objects_.back()->Start();
  }

  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) override {
    const size_t first = estimates.size();
    events = InsideSensor(events);
    while (!events.empty()) {
      if (!next_decision_us_) next_decision_us_ = After(events.front().t_us);
      const auto is_later = [this](const Event& event) { return event.t_us >= *next_decision_us_; };
      const auto end = std::find_if(events.begin(), events.end(), is_later);
      const auto count = static_cast<size_t>(end - events.begin());
      for (const auto& object : objects_) object->AddEvents(events.first(count), estimates);
      if (end != events.end()) DecideUntil(end->t_us, estimates);
      events.remove_prefix(count);
    }
    Sort(first, estimates);
  }
  void AdvanceTime(int64_t t_us, std::vector<PoseEstimate>& estimates) override {
    const size_t first = estimates.size();
    if (next_decision_us_ && t_us >= *next_decision_us_) DecideUntil(t_us, estimates);
    for (const auto& object : objects_) object->AdvanceTime(t_us, estimates);
    Sort(first, estimates);
  }
  EventGap Skip(absl::Span<const Event> events, int64_t t_us) override {
    EventGap gap;
    for (const auto& object : objects_) gap = object->Skip(InsideSensor(events), t_us);
    if (next_decision_us_) next_decision_us_ = std::max(*next_decision_us_, After(t_us));
    return gap;
  }
  void Finish(std::vector<PoseEstimate>& estimates) override {
    const size_t first = estimates.size();
    for (const auto& object : objects_) object->Finish(estimates);
    Sort(first, estimates);
  }
  void ResetPose(size_t object_index, const RigidTransform& camera_from_object) override {
    objects_[object_index]->ResetPose(camera_from_object);
  }
  void SetPhaseListener(const PhaseListener& listener) override {
    for (const auto& object : objects_) object->SetPhaseListener(listener);
  }
  size_t num_objects() const override { return objects_.size(); }
  TrackState state(size_t object_index) const override { return objects_[object_index]->reporting_tracker().state(); }
  InitializationReport initialization(size_t object_index) const override {
    return objects_[object_index]->reporting_tracker().initialization();
  }
  uint32_t losses(size_t object_index) const override { return objects_[object_index]->losses(); }
  bool Outline(size_t object_index, ObjectOutline& outline) const override {
    return objects_[object_index]->Outline(outline);
  }
  void SaveState(StateWriter& writer) const override {
    writer(next_decision_us_);
    for (const auto& object : objects_) object->SaveState(writer);
  }
  void LoadState(StateReader& reader) override {
    reader(next_decision_us_);
    for (const auto& object : objects_) object->LoadState(reader);
  }

 private:
  // The views may be larger than the sensor, whose pixels alone have bearings.
  absl::Span<const Event> InsideSensor(absl::Span<const Event> events) {
    const auto is_inside = [this](const Event& event) {
      return event.x < camera_.width_px && event.y < camera_.height_px;
    };
    if (std::all_of(events.begin(), events.end(), is_inside)) return events;
    inside_.clear();
    std::copy_if(events.begin(), events.end(), std::back_inserter(inside_), is_inside);
    return inside_;
  }

  // The first time of a decision after t_us: multiples of the interval, so that they do not depend on how the events
  // are divided into calls.
  static int64_t After(int64_t t_us) { return (t_us / kDecisionUs + 1) * kDecisionUs; }

  // The sensor's clock has passed the next decision and reached t_us without further events.
  void DecideUntil(int64_t t_us, std::vector<PoseEstimate>& estimates) {
    const int64_t decision_us = After(t_us) - kDecisionUs;
    for (const auto& object : objects_) {
      object->AdvanceTime(decision_us, estimates);
      object->Decide(decision_us);
    }
    next_decision_us_ = After(t_us);
  }

  static void Sort(size_t first, std::vector<PoseEstimate>& estimates) {
    std::stable_sort(estimates.begin() + static_cast<std::ptrdiff_t>(first), estimates.end(),
                     [](const PoseEstimate& a, const PoseEstimate& b) { return a.t_us < b.t_us; });
  }

  const std::vector<View> views_;
  const CameraModel camera_;
  const TrackerOptions options_;
  std::vector<Event> inside_;  // events of the sensor, if some are outside
  std::vector<std::unique_ptr<ViewedObject>> objects_;
  std::optional<int64_t> next_decision_us_;  // nullopt before the first event
};

}  // namespace

absl::StatusOr<std::unique_ptr<Tracker>> MakeViewTracker(std::vector<ObjectToTrack> objects, const CameraModel& camera,
                                                         const TrackerOptions& options,
                                                         const UndistortionTable& table) {
  std::vector<View> views;
  for (const LensView& lens : MakeLensViews(camera)) {
    views.push_back({lens, std::make_shared<const CameraTables>(lens.camera, table.Turned(lens.view_from_camera))});
  }
  auto tracker = std::make_unique<ViewTracker>(std::move(views), camera, options);
  for (ObjectToTrack& object : objects) EVPOSE_RETURN_IF_ERROR(tracker->Add(std::move(object)));
  return tracker;
}

}  // namespace evpose
