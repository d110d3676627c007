// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/model_bench.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/contours/edge_elements.h"
#include "core/experiments/speed/measured_time.h"
#include "core/experiments/tracking/model_run.h"
#include "core/experiments/tracking/tracking_recordings.h"
#include "core/models/visibility.h"
#include "core/numerics/statistics.h"
#include "core/simulation/simulator.h"
#include "core/tracking/tracker.h"

namespace evpose {
namespace {

constexpr double kNoValue = std::numeric_limits<double>::quiet_NaN();
// HealthOptions::max_uncertainty_px by default: wider than the gate of the association.
constexpr double kWeakPx = HealthOptions().max_uncertainty_px;
// Time before a loss in which a weak pose explains it: some windows, and the time in which the tracker reports a loss.
constexpr int64_t kBeforeLossUs = 50'000;
// Share of the time with a good pose, at the least, of a model that is kept: the first windows give no pose.
constexpr double kKeptCoverage = 0.95;

std::string SymmetryText(const ObjectModel& model) {
  if (model.continuous_symmetry) {
    return model.continuous_symmetry->kind == ContinuousSymmetry::Kind::kAxis ? "axis" : "sphere";
  }
  return model.symmetries.size() > 1 ? absl::StrCat(model.symmetries.size()) : "none";
}

// Mean number of visible lines and elements at poses of the trajectory.
double MeanElements(const ObjectModel& model, const CameraModel& camera, const Trajectory& truth) {
  constexpr size_t kPoses = 16;  // spread over the recording: the number of elements changes slowly with the view
  const VisibilityTester lines(model, TrackerOptions().visibility);
  const TriangleBvh faces(model.vertices, model.triangles);
  const EdgeElementExtractor extractor(model, faces, {});
  std::vector<EdgeElement> elements;
  size_t count = 0;
  int level = -1;
  for (size_t i = 0; i < kPoses; ++i) {
    const RigidTransform& pose = truth[i * (truth.size() - 1) / (kPoses - 1)].camera_from_object;
    count += lines.VisibleSegments(camera, pose).size();
    if (!extractor.has_curves()) continue;
    level = DetailLevel(model, camera, pose, level);
    extractor.Extract(camera, pose, level, elements);
    count += elements.size();
  }
  return static_cast<double>(count) / kPoses;
}

absl::StatusOr<TrackingOutput> TrackFromTruth(const ModelBenchOptions& options, const ModelRunInputs& inputs,
                                              EventRate& rate, const std::function<bool(double)>& on_progress) {
  TrackerOptions tracker_options = options.tracker;
  tracker_options.initialization.is_automatic = false;  // a lost object stays lost
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker,
                          Tracker::Create(inputs.model, inputs.simulation.camera, tracker_options,
                                          inputs.truth.front().camera_from_object));
  TrackingOutput output;
  const auto on_events = [&](absl::Span<const Event> events) -> absl::Status {
    rate.Add(events);
    output.compute_s += ProcessorSecondsOf([&] { tracker->AddEvents(events, output.poses); });
    if (events.empty()) return absl::OkStatus();
    const double done = static_cast<double>(events.back().t_us - inputs.simulation.t_begin_us) /
                        static_cast<double>(inputs.simulation.duration_us);
    return on_progress(done) ? absl::OkStatus() : absl::CancelledError("interrupted");
  };
  EVPOSE_RETURN_IF_ERROR(PlayRun(inputs.simulation, inputs.directory, on_events, on_progress));
  output.compute_s += ProcessorSecondsOf([&] { tracker->Finish(output.poses); });
  output.losses = tracker->losses();
  return output;
}

// Sets the weak poses to DEGRADED, so that they do not count as wrong; returns their times, in order.
std::vector<int64_t> SetWeakPosesAside(const OutlineUncertainty& uncertainty, std::vector<PoseEstimate>& poses) {
  std::vector<int64_t> times;
  for (PoseEstimate& pose : poses) {
    if (uncertainty.LargestSigmaPx(pose) <= kWeakPx) continue;
    times.push_back(pose.t_us);
    if (pose.state == TrackState::kTracking) pose.state = TrackState::kDegraded;
  }
  return times;
}

ModelOutcome OutcomeOf(const TrackingScore& score, const std::vector<int64_t>& weak_us) {
  if (score.losses == 0 && score.evaluation.coverage_ratio >= kKeptCoverage) return ModelOutcome::kKept;
  if (score.evaluation.losses_at_us.empty()) return ModelOutcome::kLost;
  const int64_t lost_us = score.evaluation.losses_at_us.front();
  const auto weak = std::lower_bound(weak_us.begin(), weak_us.end(), lost_us - kBeforeLossUs);
  return weak != weak_us.end() && *weak <= lost_us + kBeforeLossUs ? ModelOutcome::kWeak : ModelOutcome::kLost;
}

void SetErrorsOfRun(const std::vector<TrajectoryError>& errors, const std::vector<int64_t>& weak_us, ModelRun& run) {
  double sum = 0.0;
  std::vector<double> angles;
  for (const TrajectoryError& error : errors) {
    if (std::binary_search(weak_us.begin(), weak_us.end(), error.t_us)) continue;
    sum += error.position_of_depth * error.position_of_depth;
    angles.push_back(error.rotation_rad);
  }
  if (!errors.empty()) {
    run.weak_ratio = 1.0 - static_cast<double>(angles.size()) / static_cast<double>(errors.size());
  }
  run.position_rmse_of_depth = run.rotation_median_rad = run.rotation_p95_rad = kNoValue;
  if (angles.empty()) return;
  run.position_rmse_of_depth = std::sqrt(sum / static_cast<double>(angles.size()));
  std::sort(angles.begin(), angles.end());
  run.rotation_median_rad = InterpolatedQuantile(angles, 0.5);
  run.rotation_p95_rad = InterpolatedQuantile(angles, 0.95);
}

absl::StatusOr<ModelRun> RunOnce(const ModelBenchOptions& options, const ModelRunInputs& inputs,
                                 const std::function<bool(double)>& on_progress) {
  const SimulationOptions& simulation = inputs.simulation;
  EventRate rate(simulation.t_begin_us);
  EVPOSE_ASSIGN_OR_RETURN(TrackingOutput output, TrackFromTruth(options, inputs, rate, on_progress));
  EVPOSE_ASSIGN_OR_RETURN(const TrackingScore with_weak,
                          ScoreTracking(simulation, *inputs.model, inputs.truth, rate, output));
  const OutlineUncertainty uncertainty(*inputs.model, simulation.camera.MaxFocalPx());
  const std::vector<int64_t> weak_us = SetWeakPosesAside(uncertainty, output.poses);
  EVPOSE_ASSIGN_OR_RETURN(const TrackingScore score,
                          ScoreTracking(simulation, *inputs.model, inputs.truth, rate, output));
  ModelRun run;
  run.seed = simulation.seed;
  run.events_per_s = static_cast<double>(rate.num_events()) / (1e-6 * static_cast<double>(simulation.duration_us));
  run.outcome = OutcomeOf(score, weak_us);
  SetErrorsOfRun(score.errors, weak_us, run);
  run.longest_wrong_s = score.longest_wrong_tracking_s;
  run.longest_weak_wrong_s = with_weak.longest_wrong_tracking_s;
  run.compute_ratio = score.compute_ratio;
  return run;
}

bool IsBetter(const ModelRun& a, const ModelRun& b) {
  if (a.outcome != b.outcome) return a.outcome < b.outcome;
  if (std::isnan(b.position_rmse_of_depth)) return !std::isnan(a.position_rmse_of_depth);
  return a.position_rmse_of_depth < b.position_rmse_of_depth;
}

void Summarise(ModelBenchRow& row) {
  row.summary = {};
  for (const ModelRun& run : row.runs) {
    for (double ModelRun::*member :
         {&ModelRun::events_per_s, &ModelRun::position_rmse_of_depth, &ModelRun::rotation_median_rad,
          &ModelRun::rotation_p95_rad, &ModelRun::weak_ratio}) {
      row.summary.*member += run.*member / static_cast<double>(row.runs.size());
    }
    for (double ModelRun::*member :
         {&ModelRun::longest_wrong_s, &ModelRun::longest_weak_wrong_s, &ModelRun::compute_ratio}) {
      row.summary.*member = std::max(row.summary.*member, run.*member);
    }
    row.num_kept += run.outcome == ModelOutcome::kKept ? 1 : 0;
    row.num_weak += run.outcome == ModelOutcome::kWeak ? 1 : 0;
  }
  row.worst_run = static_cast<int>(std::max_element(row.runs.begin(), row.runs.end(), IsBetter) - row.runs.begin());
  row.summary.outcome = row.runs[row.worst_run].outcome;
  row.summary.seed = row.runs[row.worst_run].seed;
}

// Prepares a model and sets what is known without a recording.
absl::StatusOr<std::shared_ptr<const ObjectModel>> Prepare(const ModelBenchOptions& options, ModelBenchRow& row) {
  absl::StatusOr<std::shared_ptr<const ObjectModel>> model;
  row.preparation_s =
      ProcessorSecondsOf([&] { model = LoadBenchModel(options, row.model.path, row.model.metres_per_unit); });
  if (!model.ok()) return model;
  row.diameter_m = (*model)->diameter_m;
  row.triangles = (*model)->triangles.size();
  row.lines = (*model)->lines.size();
  row.curves = (*model)->curves.size();
  row.regions = (*model)->surface.regions.size();
  row.symmetry = SymmetryText(**model);
  return model;
}

// `on_progress` is called with the finished share of this model.
absl::StatusOr<ModelBenchRow> RunModel(const ModelBenchOptions& options, const BenchModel& bench_model,
                                       const ModelBenchProgress& on_progress) {
  ModelBenchRow row;
  row.model = bench_model;
  const absl::StatusOr<std::shared_ptr<const ObjectModel>> tracked = Prepare(options, row);
  if (!tracked.ok()) {
    row.error = std::string(tracked.status().message());
    return row;
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::shared_ptr<const ObjectModel> rendered,
                          LoadRenderedModel(options, bench_model, *tracked));
  for (int i = 0; i < options.num_seeds; ++i) {
    const std::string text = absl::StrFormat("%s, seed %d", bench_model.name, i + 1);
    const auto on_run = [&](double ratio) {
      return !on_progress || on_progress((i + ratio) / options.num_seeds, text);
    };
    EVPOSE_ASSIGN_OR_RETURN(const ModelRunInputs inputs,
                            MakeModelRun(options, bench_model, *tracked, rendered, static_cast<uint64_t>(i) + 1));
    if (i == 0) row.mean_elements = MeanElements(**tracked, inputs.simulation.camera, inputs.truth);
    EVPOSE_ASSIGN_OR_RETURN(const ModelRun run, RunOnce(options, inputs, on_run));
    row.runs.push_back(run);
  }
  Summarise(row);
  return row;
}

}  // namespace

absl::Status ModelBenchOptions::Validate() const {
  if (models.empty()) return absl::InvalidArgumentError("ModelBenchOptions.models is empty; name a model file");
  for (const BenchModel& model : models) {
    EVPOSE_RETURN_IF_ERROR(CheckPositive("BenchModel.metres_per_unit", model.metres_per_unit));
  }
  EVPOSE_RETURN_IF_ERROR(CheckRange("ModelBenchOptions.num_seeds", num_seeds, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("ModelBenchOptions.duration_us", static_cast<double>(duration_us), 1e4, 1.8e9));
  EVPOSE_RETURN_IF_ERROR(CheckRange("ModelBenchOptions.noise_ratio", noise_ratio, 0.0, 0.9));
  EVPOSE_RETURN_IF_ERROR(SimulationPreset("cube", camera).status());
  return tracker.Validate();
}

absl::Status RunModelBench(const ModelBenchOptions& options, const std::function<void(const ModelBenchRow&)>& on_row,
                           const ModelBenchProgress& on_progress) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  const auto count = static_cast<double>(options.models.size());
  for (size_t i = 0; i < options.models.size(); ++i) {
    const ModelBenchProgress on_model = [&](double ratio, const std::string& text) {
      return !on_progress || on_progress((static_cast<double>(i) + ratio) / count, text);
    };
    EVPOSE_ASSIGN_OR_RETURN(const ModelBenchRow row, RunModel(options, options.models[i], on_model));
    on_row(row);
  }
  return absl::OkStatus();
}

}  // namespace evpose
