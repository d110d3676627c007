// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/first_pose_bench.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/experiments/speed/measured_time.h"
#include "core/experiments/tracking/model_run.h"
#include "core/experiments/tracking/wrong_time.h"
#include "core/initialization/check_lines.h"
#include "core/initialization/search_model.h"
#include "core/initialization/templates/template_search.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

constexpr int64_t kStartStepUs = 1000;  // microseconds of events per call
// Pixels: motion of a point of the object in the image that a first pose requires. The times to a first pose count from
// there, because before it the edges have hardly any events.
constexpr double kMovedPx = 2.0;

SearchTrial RunSearch(const FirstPoseRun& run, const TrackerOptions& options, int64_t t_us, TemplateSearch& search) {
  SearchTrial trial;
  trial.t_us = t_us;
  const std::vector<PixelEvent> events = StoredEvents(run, options, run.inputs.simulation.t_begin_us, t_us);
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
  }
  if (!run.is_absent) trial.rank = RankOfRight(run, found);
  return trial;
}

// Microseconds from the start until a vertex has moved in the image; -1: never in the recording.
int64_t MovedAfter(const FirstPoseRun& run, int64_t start_us) {
  // Number of vertices that are tested, spread over the list: the largest motion of all of them differs little.
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

void CountState(const FirstPoseRun& run, const PoseEstimate& estimate, bool is_right, ReportedStates& states) {
  const int right = is_right ? 1 : 0;
  switch (estimate.state) {
    case TrackState::kTracking:
      ++states.tracking;
      states.tracking_right += right;
      break;
    case TrackState::kDegraded:
      ++states.degraded;
      states.degraded_right += right;
      break;
    case TrackState::kAmbiguous:
      ++states.ambiguous;
      states.ambiguous_right += right;
      for (const PoseAlternative& alternative : estimate.alternatives) {
        const std::optional<PoseError> error = run.ErrorAt(estimate.t_us, alternative.camera_from_object);
        if (error && error->is_right()) ++states.ambiguous_among;
      }
      break;
    default:
      break;
  }
}

absl::StatusOr<FirstPoseStart> RunStart(const FirstPoseRun& run, const FirstPoseBenchOptions& options,
                                        int64_t start_us) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker, run.MakeTracker(options.bench.tracker));
  FirstPoseStart start;
  start.t_start_us = start_us;
  start.moved_us = MovedAfter(run, start_us);
  WrongTime wrong;
  for (int64_t t_us = start_us; t_us < start_us + options.watch_us; t_us += kStartStepUs) {
    std::vector<PoseEstimate> estimates;
    const double seconds =
        ProcessorSecondsOf([&] { tracker->AddEvents(run.Between(t_us, t_us + kStartStepUs), estimates); });
    if (start.right_us < 0) start.compute_s += seconds;
    for (const PoseEstimate& estimate : estimates) {
      const std::optional<PoseError> error = run.ErrorAt(estimate.t_us, estimate.camera_from_object);
      if (!error) continue;
      const bool is_right = run.IsRight(*error);
      CountState(run, estimate, is_right, start.states);
      const bool is_wrong = estimate.state == TrackState::kTracking && !is_right;
      wrong.Add(estimate.t_us, is_wrong);
      if (is_wrong) {
        if (start.wrong_at_us < 0) start.wrong_at_us = estimate.t_us;
        start.wrong.rotation_rad = std::max(start.wrong.rotation_rad, error->rotation_rad);
        start.wrong.translation_ratio = std::max(start.wrong.translation_ratio, error->translation_ratio);
      }
      if (estimate.state == TrackState::kTracking && is_right && start.right_us < 0) {
        start.right_us = t_us + kStartStepUs - start_us;
      }
    }
  }
  wrong.Finish(start_us + options.watch_us);
  start.longest_wrong_us = wrong.longest_us();
  start.searches = tracker->initialization().attempts;
  if (!options.explains || start.is_found()) return start;
  const int64_t end_us = start_us + std::min(options.watch_us, std::max<int64_t>(0, start.moved_us) + kFoundWithinUs);
  EVPOSE_ASSIGN_OR_RETURN(
      start.explanation, ExplainStart(run, options.bench.tracker, start_us, end_us, start.moved_us >= 0, start.states));
  return start;
}

// Runs all searches and starts of one recording.
absl::Status RunRecording(const FirstPoseBenchOptions& options, const FirstPoseRun& run,
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
  const auto tracked = LoadBenchModel(options.bench, bench_model.path, bench_model.metres_per_unit);
  if (!tracked.ok()) {
    row.error = std::string(tracked.status().message());
    return row;
  }
  const BenchModel& shown = options.shown ? *options.shown : bench_model;
  EVPOSE_ASSIGN_OR_RETURN(const std::shared_ptr<const ObjectModel> rendered,
                          LoadRenderedModel(options.bench, shown, options.shown ? nullptr : *tracked));
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
                            MakeModelRun(options.bench, shown, *tracked, rendered, static_cast<uint64_t>(i) + 1));
    EVPOSE_ASSIGN_OR_RETURN(FirstPoseRun run, LoadFirstPoseRun(std::move(inputs), on_run));
    run.search_model = search_model;
    run.template_model = template_model;
    run.is_absent = options.shown.has_value();
    EVPOSE_RETURN_IF_ERROR(RunRecording(options, run, on_run, row));
  }
  return row;
}

}  // namespace

absl::Status FirstPoseBenchOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(bench.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckRange("FirstPoseBenchOptions.num_starts", num_starts, 1, 10'000));
  if (shown && explains) {
    return absl::InvalidArgumentError("FirstPoseBenchOptions.explains: no pose of an absent object is right");
  }
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
