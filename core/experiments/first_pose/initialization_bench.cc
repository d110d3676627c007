// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/initialization_bench.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "absl/types/span.h"
#include "core/base/check_range.h"
#include "core/base/find_named.h"
#include "core/base/status_macros.h"
#include "core/baselines/first_pose/published_bnb.h"
#include "core/experiments/first_pose/initialization_methods.h"
#include "core/experiments/first_pose/line_trial.h"
#include "core/experiments/speed/measured_time.h"
#include "core/numerics/random.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();

// A trial with all inputs that a method may use.
struct PreparedTrial {
  uint64_t trial_seed = 0;
  LineTrial trial;
  std::vector<LineMatch> matches;
  std::vector<PointMatch> point_matches;
  PosePrior prior;
  uint64_t method_seed = 0;
};

// Object points that correspond to the noisy ends of each segment: the ends of the visible part of its line that fits
// best, in the order that fits best.
std::vector<PointMatch> TruePointMatches(const LineTrialGenerator& trials, const LineTrial& trial) {
  std::vector<PointMatch> matches;
  for (size_t j = 0; j < trial.segments.size(); ++j) {
    double nearest = std::numeric_limits<double>::infinity();
    std::array<PointMatch, 2> ends;
    for (const VisibleSegment& part : trial.visible) {
      if (part.line != trial.model_line[j]) continue;
      const ModelLine& line = trials.model().lines[part.line];
      for (const bool is_reversed : {false, true}) {
        const double first = is_reversed ? part.end : part.begin;
        const double second = is_reversed ? part.begin : part.end;
        const Eigen::Vector3d a = line.p1 + first * (line.p2 - line.p1);
        const Eigen::Vector3d b = line.p1 + second * (line.p2 - line.p1);
        const ImageSegment& segment = trial.segments[j];
        const double error = (trials.camera().Project(trial.camera_from_object * a) - segment.p1_px).norm() +
                             (trials.camera().Project(trial.camera_from_object * b) - segment.p2_px).norm();
        if (error >= nearest) continue;
        nearest = error;
        ends = {PointMatch{a, segment.p1_px}, PointMatch{b, segment.p2_px}};
      }
    }
    if (std::isfinite(nearest)) matches.insert(matches.end(), ends.begin(), ends.end());
  }
  return matches;
}

// Prior for the methods that require one: a generous guess for a tracker that has just lost its object. The deviation
// of its mean from the truth is drawn from the prior.
PosePrior DrawPrior(const RigidTransform& truth, Random& random) {
  constexpr double kRotationRad = 0.1745;     // 10 deg; the median error of the rotation is 16 deg
  constexpr double kTranslationRatio = 0.05;  // of the depth, for each coordinate
  PosePrior prior = {truth, kRotationRad, kTranslationRatio};
  prior.camera_from_object = prior.Draw(random);
  return prior;
}

std::vector<PreparedTrial> PrepareTrials(const InitializationBenchOptions& options, const LineTrialGenerator& trials) {
  Random seeds(options.seed);
  std::vector<PreparedTrial> prepared(options.num_trials);
  for (PreparedTrial& p : prepared) {
    p.trial_seed = seeds.NextU64();
    p.trial = trials.Make(p.trial_seed);
    p.matches = TrueMatches(trials, p.trial);
    p.point_matches = TruePointMatches(trials, p.trial);
    Random random(seeds.NextU64());
    p.prior = DrawPrior(p.trial.camera_from_object, random);
    p.method_seed = random.NextU64();
  }
  return prepared;
}

// Removes all inputs that the method may not use.
InitializationProblem ProblemFor(const InitializationMethod& method, const LineTrialGenerator& trials,
                                 const PreparedTrial& prepared) {
  InitializationProblem problem{trials.model(), trials.camera(), {}, {}, {}, {}, prepared.method_seed};
  if (method.prior_knowledge == PriorKnowledge::kCorrespondences) {
    problem.matches = prepared.matches;
    problem.point_matches = prepared.point_matches;
    return problem;
  }
  problem.segments = prepared.trial.segments;
  if (method.prior_knowledge == PriorKnowledge::kPosePrior) problem.prior = prepared.prior;
  return problem;
}

using FoundPoses = std::vector<absl::StatusOr<RigidTransform>>;  // result of each trial

InitializationBenchRow RunMethod(const InitializationMethod& method, const InitializationFunction& estimate,
                                 const LineTrialGenerator& trials, absl::Span<const PreparedTrial> prepared,
                                 FoundPoses& poses) {
  const double diagonal_px = std::hypot(trials.camera().width_px, trials.camera().height_px);
  InitializationBenchRow row;
  row.method = method.name;
  row.num_trials = static_cast<int>(prepared.size());
  std::vector<double> times_ms;
  std::vector<double> errors_px;
  double sum_right_px = 0.0;
  for (const PreparedTrial& p : prepared) {
    const InitializationProblem problem = ProblemFor(method, trials, p);
    const auto begin = std::chrono::steady_clock::now();
    absl::StatusOr<RigidTransform> pose = estimate(problem);
    times_ms.push_back(MillisecondsSince(begin));
    errors_px.push_back(diagonal_px);
    row.num_none += !pose.ok();
    const PoseError error = pose.ok() ? CompareWithTruth(trials, p.trial, *pose) : PoseError();
    if (pose.ok()) errors_px.back() = error.reprojection_px;
    poses.push_back(std::move(pose));
    if (!poses.back().ok() || !error.is_right()) {
      row.failed_seeds.push_back(p.trial_seed);
      continue;
    }
    ++row.num_right;
    sum_right_px += error.reprojection_px;
  }
  row.reprojection_mean_px = Mean(errors_px);
  row.reprojection_median_px = UpperMedianOr(errors_px, kNoNumber);
  row.reprojection_mean_right_px = row.num_right > 0 ? sum_right_px / row.num_right : kNoNumber;
  row.worst_ms = *std::max_element(times_ms.begin(), times_ms.end());
  row.median_ms = UpperMedianOr(times_ms, kNoNumber);
  return row;
}

absl::StatusOr<CertificateCounts> Certify(const LineTrialGenerator& trials, absl::Span<const PreparedTrial> prepared,
                                          const FoundPoses& poses, const RotationBnbOptions& options) {
  CertificateCounts counts;
  std::vector<double> times_ms;
  for (size_t i = 0; i < poses.size(); ++i) {
    if (!poses[i].ok()) continue;
    const auto begin = std::chrono::steady_clock::now();
    EVPOSE_ASSIGN_OR_RETURN(
        const RotationCertificate certificate,
        CertifyPose(trials.model(), trials.camera(), prepared[i].trial.segments, *poses[i], options));
    times_ms.push_back(MillisecondsSince(begin));
    counts.num_maximum += certificate.optimality == RotationOptimality::kMaximum;
    counts.num_not_maximum += certificate.optimality == RotationOptimality::kNotMaximum;
    counts.num_unknown += certificate.optimality == RotationOptimality::kUnknown;
  }
  counts.median_ms = UpperMedianOr(times_ms, kNoNumber);
  return counts;
}

absl::StatusOr<std::vector<InitializationMethod>> ChosenMethods(const InitializationBenchOptions& options) {
  return FindAllNamed(InitializationMethods(), options.methods, "no method of initialisation is called \"$0\"");
}

// Runs all methods on one object with one clutter.
absl::Status RunScenario(const InitializationBenchOptions& options, SimulatedObject object, const BenchClutter& clutter,
                         absl::Span<const InitializationMethod> methods,
                         const std::function<bool(const InitializationBenchRow&)>& on_row,
                         std::vector<InitializationBenchRow>& rows) {
  const LineTrialOptions trial_options = {object, options.noise_px, clutter.num_spurious, clutter.num_missing};
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<LineTrialGenerator> trials, LineTrialGenerator::Create(trial_options));
  const std::vector<PreparedTrial> prepared = PrepareTrials(options, *trials);
  const auto model = std::make_shared<const ObjectModel>(trials->model());
  for (const InitializationMethod& method : methods) {
    EVPOSE_ASSIGN_OR_RETURN(const InitializationFunction estimate, method.make(model, trials->camera()));
    const size_t limit = options.is_unlimited ? prepared.size() : static_cast<size_t>(method.max_trials);
    const absl::Span<const PreparedTrial> used = absl::MakeSpan(prepared).first(std::min(limit, prepared.size()));
    FoundPoses poses;
    InitializationBenchRow row = RunMethod(method, estimate, *trials, used, poses);
    if (options.certifies && method.prior_knowledge != PriorKnowledge::kCorrespondences) {
      EVPOSE_ASSIGN_OR_RETURN(row.certificates, Certify(*trials, used, poses, options.certificate));
    }
    row.object = object;
    row.clutter = clutter;
    rows.push_back(row);
    if (on_row && !on_row(rows.back())) return absl::CancelledError("interrupted");
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status InitializationBenchOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("InitializationBenchOptions.num_trials", num_trials, 1, 1'000'000));
  EVPOSE_RETURN_IF_ERROR(
      CheckRange("InitializationBenchOptions.objects.size", static_cast<double>(objects.size()), 1, 100));
  EVPOSE_RETURN_IF_ERROR(
      CheckRange("InitializationBenchOptions.clutter.size", static_cast<double>(clutter.size()), 1, 100));
  for (const BenchClutter& c : clutter) {
    const LineTrialOptions trial = {SimulatedObject::kCube, noise_px, c.num_spurious, c.num_missing};
    EVPOSE_RETURN_IF_ERROR(trial.Validate());
  }
  EVPOSE_RETURN_IF_ERROR(certificate.Validate());
  return ChosenMethods(*this).status();
}

absl::StatusOr<std::vector<InitializationBenchRow>> RunInitializationBench(
    const InitializationBenchOptions& options, const std::function<bool(const InitializationBenchRow&)>& on_row) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<InitializationMethod> methods, ChosenMethods(options));
  std::vector<InitializationBenchRow> rows;
  for (const SimulatedObject object : options.objects) {
    for (const BenchClutter& clutter : options.clutter) {
      EVPOSE_RETURN_IF_ERROR(RunScenario(options, object, clutter, methods, on_row, rows));
    }
  }
  return rows;
}

}  // namespace evpose
