// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/first_pose_bench.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/association/association.h"
#include "core/association/camera_tables.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/experiments/first_pose/pose_comparison.h"
#include "core/experiments/speed/measured_time.h"
#include "core/experiments/tracking/model_run.h"
#include "core/experiments/tracking/tracking_recordings.h"
#include "core/initialization/pose_search.h"
#include "core/initialization/search_model.h"
#include "core/initialization/templates/template_search.h"
#include "core/tracking/tracker.h"
#include "core/windows/window_memory.h"

namespace evpose {
namespace {

constexpr int64_t kStartStepUs = 1000;  // microseconds of events per call
// Errors of a pose from which tracking finds the true one.
constexpr double kCaptureRad = 6.0 * 0.017453292519943295;
constexpr double kCaptureRatio = 0.03;
// Motion of a point of the object in the image that a first pose requires.
constexpr double kMovedPx = 2.0;

struct LoadedRun {
  ModelRunInputs inputs;
  std::vector<Event> events;
  std::shared_ptr<const SearchModel> search_model;  // null if the lines determine no pose
  std::shared_ptr<const TemplateModel> template_model;
  std::shared_ptr<const CameraTables> tables;

  absl::Span<const Event> Between(int64_t begin_us, int64_t end_us) const {
    const auto earlier = [](const Event& event, int64_t t_us) { return event.t_us < t_us; };
    const auto begin = std::lower_bound(events.begin(), events.end(), begin_us, earlier);
    const auto end = std::lower_bound(begin, events.end(), end_us, earlier);
    return absl::MakeConstSpan(events).subspan(begin - events.begin(), end - begin);
  }
  // nullopt outside the recording.
  std::optional<PoseError> ErrorAt(int64_t t_us, const RigidTransform& estimate) const {
    const absl::StatusOr<RigidTransform> truth = Interpolate(inputs.truth, t_us);
    if (!truth.ok()) return std::nullopt;
    return ComparePoses(*inputs.model, inputs.simulation.camera, {}, *truth, estimate);
  }
};

// The events that a tracker would search in at t_us.
std::vector<PixelEvent> StoredEvents(const LoadedRun& run, const TrackerOptions& options, int64_t t_us) {
  const CameraModel& camera = run.inputs.simulation.camera;
  const InitializationOptions& initialization = options.initialization;
  WindowMemory memory(initialization.memory_us, initialization.max_window_events, initialization.max_events);
  EventWindower windower(options.windows, {camera.width_px, camera.height_px});
  const auto on_window = [&](const EventWindow& window) { memory.Add(window); };
  windower.Add(run.Between(t_us - initialization.memory_us, t_us), on_window);
  windower.Finish(on_window);
  std::vector<PixelEvent> pixel_events;
  for (size_t i = 0; i < memory.size(); ++i) {
    const EventWindow window = memory.At(i);
    for (const WindowEvent& event : window.events) {
      const auto observation = Observe(camera, run.tables->undistortion, event, window.t_mid_us());
      if (!observation) continue;
      pixel_events.push_back(
          {event.t_us, static_cast<float>(observation->u_px), static_cast<float>(observation->v_px), event.polarity});
    }
  }
  return pixel_events;
}

SearchTrial RunSearch(const LoadedRun& run, const TrackerOptions& options, int64_t t_us, TemplateSearch& search) {
  SearchTrial trial;
  trial.t_us = t_us;
  const std::vector<PixelEvent> events = StoredEvents(run, options, t_us);
  TemplateMatches found;
  trial.compute_s = ProcessorSecondsOf([&] { found = search.Find(events); });
  trial.has_moved = found.has_moved;
  trial.num_poses = static_cast<int>(found.matches.size());
  trial.best_rotation_rad = std::numbers::pi;
  for (size_t i = 0; i < found.matches.size(); ++i) {
    trial.scores.push_back(found.matches[i].score);
    const std::optional<PoseError> error = run.ErrorAt(found.t_us, found.matches[i].camera_from_object);
    if (!error) continue;
    trial.best_rotation_rad = std::min(trial.best_rotation_rad, error->rotation_rad);
    const bool is_right = error->rotation_rad <= kCaptureRad && error->translation_ratio <= kCaptureRatio;
    if (is_right && trial.rank < 0) trial.rank = static_cast<int>(i);
  }
  return trial;
}

// Microseconds from the start until a vertex has moved in the image; -1: never in the recording.
int64_t MovedAfter(const LoadedRun& run, int64_t start_us) {
  constexpr size_t kVertices = 64;
  const CameraModel& camera = run.inputs.simulation.camera;
  const std::vector<Eigen::Vector3d>& vertices = run.inputs.model->vertices;
  const size_t stride = std::max<size_t>(1, vertices.size() / kVertices);
  const absl::StatusOr<RigidTransform> start = Interpolate(run.inputs.truth, start_us);
  if (!start.ok()) return -1;
  for (int64_t t_us = start_us + kStartStepUs;; t_us += kStartStepUs) {
    const absl::StatusOr<RigidTransform> pose = Interpolate(run.inputs.truth, t_us);
    if (!pose.ok()) return -1;
    for (size_t i = 0; i < vertices.size(); i += stride) {
      if ((camera.Project(*pose * vertices[i]) - camera.Project(*start * vertices[i])).norm() >= kMovedPx) {
        return t_us - start_us;
      }
    }
  }
}

absl::StatusOr<FirstPoseStart> RunStart(const LoadedRun& run, const FirstPoseBenchOptions& options, int64_t start_us) {
  ObjectToTrack object;
  object.model = run.inputs.model;
  object.search_model = run.search_model;
  object.template_model = run.template_model;
  EVPOSE_ASSIGN_OR_RETURN(
      const std::unique_ptr<Tracker> tracker,
      Tracker::Create({std::move(object)}, run.inputs.simulation.camera, options.bench.tracker, run.tables));
  FirstPoseStart start;
  start.t_start_us = start_us;
  start.moved_us = MovedAfter(run, start_us);
  int64_t wrong_since_us = -1;
  for (int64_t t_us = start_us; t_us < start_us + options.watch_us; t_us += kStartStepUs) {
    std::vector<PoseEstimate> estimates;
    const double seconds =
        ProcessorSecondsOf([&] { tracker->AddEvents(run.Between(t_us, t_us + kStartStepUs), estimates); });
    if (start.right_us < 0) start.compute_s += seconds;
    for (const PoseEstimate& estimate : estimates) {
      const std::optional<PoseError> error = run.ErrorAt(estimate.t_us, estimate.camera_from_object);
      if (!error) continue;
      const bool is_wrong = estimate.state == TrackState::kTracking && !error->is_right();
      if (!is_wrong) wrong_since_us = -1;
      if (is_wrong && wrong_since_us < 0) wrong_since_us = estimate.t_us;
      if (is_wrong) start.longest_wrong_us = std::max(start.longest_wrong_us, estimate.t_us - wrong_since_us);
      if (estimate.state == TrackState::kTracking && error->is_right() && start.right_us < 0) {
        start.right_us = t_us + kStartStepUs - start_us;
      }
    }
  }
  start.searches = tracker->initialization().attempts;
  return start;
}

absl::StatusOr<LoadedRun> Load(ModelRunInputs inputs, const std::function<bool(double)>& on_progress) {
  LoadedRun run;
  run.inputs = std::move(inputs);
  const auto on_events = [&](absl::Span<const Event> events) -> absl::Status {
    run.events.insert(run.events.end(), events.begin(), events.end());
    return absl::OkStatus();
  };
  EVPOSE_RETURN_IF_ERROR(PlayRun(run.inputs.simulation, run.inputs.directory, on_events, on_progress));
  EVPOSE_ASSIGN_OR_RETURN(run.tables, MakeCameraTables(run.inputs.simulation.camera));
  return run;
}

// Runs all searches and starts of one recording.
absl::Status RunRecording(const FirstPoseBenchOptions& options, const LoadedRun& run,
                          const std::function<bool(double)>& on_progress, FirstPoseBenchRow& row) {
  const SimulationOptions& simulation = run.inputs.simulation;
  TemplateSearch search(run.template_model, simulation.camera);
  const int64_t last_us = simulation.duration_us - options.watch_us;
  for (int i = 0; i < options.num_starts; ++i) {
    const int64_t after_us = options.num_starts > 1 ? last_us * i / (options.num_starts - 1) : 0;
    const int64_t start_us = simulation.t_begin_us + after_us;
    row.trials.push_back(RunSearch(run, options.bench.tracker, start_us + options.watch_us, search));
    EVPOSE_ASSIGN_OR_RETURN(const FirstPoseStart start, RunStart(run, options, start_us));
    row.starts.push_back(start);
    if (!on_progress((i + 1.0) / options.num_starts)) return absl::CancelledError("interrupted");
  }
  return absl::OkStatus();
}

absl::StatusOr<FirstPoseBenchRow> RunModelStarts(const FirstPoseBenchOptions& options, const BenchModel& bench_model,
                                                 const ModelBenchProgress& on_progress) {
  FirstPoseBenchRow row;
  row.model = bench_model;
  const auto tracked = LoadBenchModel(bench_model.path, bench_model.metres_per_unit);
  if (!tracked.ok()) {
    row.error = std::string(tracked.status().message());
    return row;
  }
  std::shared_ptr<const ObjectModel> rendered = *tracked;
  if (!bench_model.reference_path.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(rendered, LoadBenchModel(bench_model.reference_path, 1.0));
  }
  std::shared_ptr<const SearchModel> search_model;
  if (IsSearchable(**tracked)) {
    EVPOSE_ASSIGN_OR_RETURN(search_model, MakeSearchModel(*tracked));
  }
  std::shared_ptr<const TemplateModel> template_model;
  row.preparation_s = ProcessorSecondsOf([&] { template_model = std::make_shared<const TemplateModel>(*tracked); });
  row.num_views = template_model->views().size();
  for (int i = 0; i < options.bench.num_seeds; ++i) {
    const std::string text = absl::StrFormat("%s, seed %d", bench_model.name, i + 1);
    const auto on_run = [&](double ratio) {
      return !on_progress || on_progress((i + ratio) / options.bench.num_seeds, text);
    };
    EVPOSE_ASSIGN_OR_RETURN(ModelRunInputs inputs,
                            MakeModelRun(options.bench, bench_model, *tracked, rendered, static_cast<uint64_t>(i) + 1));
    EVPOSE_ASSIGN_OR_RETURN(LoadedRun run, Load(std::move(inputs), on_run));
    run.search_model = search_model;
    run.template_model = template_model;
    EVPOSE_RETURN_IF_ERROR(RunRecording(options, run, on_run, row));
  }
  return row;
}

}  // namespace

absl::Status FirstPoseBenchOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(bench.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("FirstPoseBenchOptions.num_starts", num_starts, 1, 10'000));
  return CheckRange("FirstPoseBenchOptions.watch_us", static_cast<double>(watch_us), 1e4,
                    static_cast<double>(bench.duration_us));
}

absl::Status RunFirstPoseBench(const FirstPoseBenchOptions& options,
                               const std::function<void(const FirstPoseBenchRow&)>& on_row,
                               const ModelBenchProgress& on_progress) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  const auto count = static_cast<double>(options.bench.models.size());
  for (size_t i = 0; i < options.bench.models.size(); ++i) {
    const ModelBenchProgress on_model = [&](double ratio, const std::string& text) {
      return !on_progress || on_progress((static_cast<double>(i) + ratio) / count, text);
    };
    EVPOSE_ASSIGN_OR_RETURN(const FirstPoseBenchRow row, RunModelStarts(options, options.bench.models[i], on_model));
    on_row(row);
  }
  return absl::OkStatus();
}

}  // namespace evpose
