// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_bench.h"

#include <algorithm>
#include <ctime>
#include <filesystem>
#include <memory>
#include <utility>

#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/find_named.h"
#include "core/base/status_macros.h"
#include "core/baselines/estimators/estimator_factory.h"
#include "core/experiments/speed/measured_time.h"
#include "core/experiments/tracking/tracking_oracle.h"
#include "core/experiments/tracking/tracking_recordings.h"

namespace evpose {
namespace {

// Context of a run: tracker configuration and truth.
struct RunScene {
  SimulationOptions run;
  std::shared_ptr<const ObjectModel> model;
  Trajectory truth;
};

// One subject on one recording.
class Contestant {
 public:
  static absl::StatusOr<Contestant> Create(const TrackingSubject& subject, TrackerOptions options,
                                           const RunScene& scene) {
    options.estimator_factory = EstimatorFactoryOf(subject.estimator);
    const CameraModel& camera = scene.run.camera;
    Contestant contestant;
    if (subject.kind == TrackingSubject::Kind::kOracle) {
      EVPOSE_ASSIGN_OR_RETURN(contestant.source_, MakeTrackingOracle(scene.model, camera, options, scene.truth));
      return contestant;
    }
    std::optional<RigidTransform> first;
    if (subject.kind == TrackingSubject::Kind::kPublished) {
      options.initialization.is_automatic = false;
      first = scene.truth.front().camera_from_object;
    }
    EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<Tracker> tracker, Tracker::Create(scene.model, camera, options, first));
    contestant.tracker_ = tracker.get();
    contestant.source_ = std::move(tracker);
    return contestant;
  }

  void AddEvents(absl::Span<const Event> events) {
    output_.compute_s += ProcessorSecondsOf([&] { source_->AddEvents(events, output_.poses); });
  }
  TrackingOutput Finish() {
    source_->Finish(output_.poses);
    if (tracker_ != nullptr) output_.losses = tracker_->losses();
    return std::move(output_);
  }

 private:
  Contestant() = default;

  std::unique_ptr<PoseSource> source_;
  const Tracker* tracker_ = nullptr;  // source_ if it is a tracker
  TrackingOutput output_;
};

// Subdirectory of `recordings` for a run; shortened runs have another one.
std::string RunDirectory(const std::string& recordings, const std::string& scenario, const SimulationOptions& run,
                         bool is_shortened) {
  if (recordings.empty()) return "";
  std::string name = absl::StrFormat("%s-seed%d-path%d", scenario, run.seed, run.path_seed.value_or(run.seed));
  if (is_shortened) absl::StrAppendFormat(&name, "-%gs", 1e-6 * static_cast<double>(run.duration_us));
  return (std::filesystem::path(recordings) / name).string();
}

absl::StatusOr<std::vector<TrackingSubject>> FindSubjects(const std::vector<std::string>& names) {
  return FindAllNamed(TrackingSubjects(), names, "no estimator is called \"$0\"");
}

// Runs one scenario with all seeds, paths and estimators.
class BlockRunner {
 public:
  BlockRunner(const TrackingBenchOptions& options, const TrackingScenario& scenario,
              const std::vector<TrackingSubject>& subjects, const TrackingBenchProgress& on_progress)
      : options_(options), subjects_(subjects), on_progress_(on_progress) {
    block_.scenario = scenario;
    for (const TrackingSubject& subject : subjects)
      block_.rows.push_back({scenario.name, subject.name, {}, subject.kind, {}, {}});
  }

  // Share of the whole work from `begin` to `end`.
  absl::StatusOr<TrackingBenchBlock> Run(double begin, double end) {
    const int num_runs = options_.num_seeds * options_.num_paths;
    for (int i = 0; i < num_runs; ++i) {
      begin_ = begin + (end - begin) * i / num_runs;
      end_ = begin + (end - begin) * (i + 1) / num_runs;
      const int seed = 1 + i / options_.num_paths;
      const int path = 1 + i % options_.num_paths;
      text_ = absl::StrFormat("%s, seed %d, path %d", block_.scenario.name, seed, path);
      EVPOSE_RETURN_IF_ERROR(RunOne(TrackingRun(block_.scenario, static_cast<uint64_t>(seed),
                                                static_cast<uint64_t>(path), options_.max_duration_us)));
    }
    block_.mean_event_rate_hz =
        static_cast<double>(num_events_) / (num_runs * 1e-6 * static_cast<double>(block_.duration_us));
    for (TrackingBenchRow& row : block_.rows) row.summary = SummariseTracking(row.scores);
    for (TrackingBenchRow& row : block_.rows) {
      if (row.kind != TrackingSubject::Kind::kDefault) continue;
      row.target_checks = CheckTargets(row.summary, block_.scenario.targets);
      CompareWithPublished(row);
    }
    return std::move(block_);
  }

 private:
  void CompareWithPublished(TrackingBenchRow& row) const {
    constexpr double kMostRatio = 0.5;  // the target: at most half of the error of the published method
    for (const TrackingBenchRow& other : block_.rows) {
      if (other.estimator != "static-mm" || other.summary.overall.losses > 0) continue;
      const double ratio = row.summary.overall.evaluation.position_rmse_of_depth /
                           other.summary.overall.evaluation.position_rmse_of_depth;
      row.target_checks.push_back({"position to static-mm's", ratio, 0.0, kMostRatio, ""});
    }
  }

  absl::Status RunOne(const SimulationOptions& run) {
    EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, SimulatedModel(run));
    const RunScene scene = {run, std::make_shared<const ObjectModel>(std::move(model)), SimulatedTruth(run)};
    std::vector<Contestant> contestants;
    for (const TrackingSubject& subject : subjects_) {
      EVPOSE_ASSIGN_OR_RETURN(Contestant contestant, Contestant::Create(subject, options_.tracker, scene));
      contestants.push_back(std::move(contestant));
    }
    EVPOSE_ASSIGN_OR_RETURN(const EventRate rate, Play(run, contestants));
    num_events_ += rate.num_events();
    block_.duration_us = run.duration_us;
    if (block_.truth.empty()) block_.truth = scene.truth;
    for (size_t i = 0; i < contestants.size(); ++i) {
      EVPOSE_ASSIGN_OR_RETURN(TrackingScore score,
                              ScoreTracking(run, *scene.model, scene.truth, rate, contestants[i].Finish()));
      std::vector<TrackingScore>& scores = block_.rows[i].scores;
      if (!scores.empty()) score.errors = {};
      scores.push_back(std::move(score));
    }
    return absl::OkStatus();
  }

  absl::StatusOr<EventRate> Play(const SimulationOptions& run, std::vector<Contestant>& contestants) {
    constexpr double kSimulationShare = 0.7;  // share of the work, if there is no recording yet
    EventRate rate(run.t_begin_us);
    double simulated = 0.0;
    const auto on_events = [&](absl::Span<const Event> events) -> absl::Status {
      rate.Add(events);
      for (Contestant& contestant : contestants) contestant.AddEvents(events);
      if (events.empty()) return absl::OkStatus();
      const double done =
          static_cast<double>(events.back().t_us - run.t_begin_us) / static_cast<double>(run.duration_us);
      return Report(simulated + (1.0 - simulated) * done) ? absl::OkStatus() : absl::CancelledError("interrupted");
    };
    const auto on_simulated = [&](double ratio) {
      simulated = kSimulationShare;
      return Report(kSimulationShare * ratio);
    };
    const bool is_shortened = run.duration_us != block_.scenario.simulation.duration_us;
    const std::string directory = RunDirectory(options_.recordings, block_.scenario.name, run, is_shortened);
    EVPOSE_RETURN_IF_ERROR(PlayRun(run, directory, on_events, on_simulated));
    return rate;
  }

  // Reports the progress of the present run; false ends the work.
  bool Report(double done_ratio) { return !on_progress_ || on_progress_(begin_ + (end_ - begin_) * done_ratio, text_); }

  const TrackingBenchOptions& options_;
  const std::vector<TrackingSubject>& subjects_;
  const TrackingBenchProgress& on_progress_;
  TrackingBenchBlock block_;
  uint64_t num_events_ = 0;
  double begin_ = 0.0;  // begin of the present run, as a share of the whole work
  double end_ = 0.0;
  std::string text_;
};

}  // namespace

std::vector<TrackingSubject> TrackingSubjects() {
  using Kind = TrackingSubject::Kind;
  std::vector<TrackingSubject> subjects;
  for (const auto& [estimator, name] : kEstimatorNames) {
    const bool is_ours = estimator == Estimator::kMixture;
    subjects.push_back({std::string(name),
                        is_ours ? "ours; finds its first pose itself" : "published; given the true first pose",
                        is_ours ? Kind::kDefault : Kind::kPublished, estimator});
  }
  subjects.push_back({"oracle", "ours on every window alone, from the truth: the smallest error to be expected",
                      Kind::kOracle, Estimator::kMixture});
  return subjects;
}

absl::Status TrackingBenchOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(FindTrackingScenarios(scenarios).status());
  EVPOSE_RETURN_IF_ERROR(FindSubjects(estimators).status());
  EVPOSE_RETURN_IF_ERROR(CheckRange("TrackingBenchOptions.num_seeds", num_seeds, 1, 1000));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TrackingBenchOptions.num_paths", num_paths, 1, 1000));
  if (max_duration_us < 0) {
    return absl::InvalidArgumentError(
        absl::StrFormat("TrackingBenchOptions.max_duration_us is %d; it must not be negative", max_duration_us));
  }
  return tracker.Validate();
}

absl::Status RunTrackingBench(const TrackingBenchOptions& options,
                              const std::function<void(const TrackingBenchBlock&)>& on_block,
                              const TrackingBenchProgress& on_progress) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<TrackingScenario> scenarios, FindTrackingScenarios(options.scenarios));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<TrackingSubject> subjects, FindSubjects(options.estimators));
  for (size_t i = 0; i < scenarios.size(); ++i) {
    const double share = 1.0 / static_cast<double>(scenarios.size());
    BlockRunner runner(options, scenarios[i], subjects, on_progress);
    EVPOSE_ASSIGN_OR_RETURN(const TrackingBenchBlock block,
                            runner.Run(share * static_cast<double>(i), share * static_cast<double>(i + 1)));
    on_block(block);
  }
  return absl::OkStatus();
}

}  // namespace evpose
