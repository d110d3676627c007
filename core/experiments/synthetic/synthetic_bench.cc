// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/synthetic/synthetic_bench.h"

#include <algorithm>
#include <array>
#include <chrono>

#include "core/base/check_range.h"
#include "core/base/find_named.h"
#include "core/base/status_macros.h"
#include "core/experiments/speed/measured_time.h"
#include "core/numerics/math.h"
#include "core/numerics/random.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Pixels: lower bound, because a filter with a standard deviation of zero has no gate.
constexpr double kMinFilterSigmaPx = 0.2;

// Values of the paper, which does not give the numbers of lines.
constexpr double kNoisesPx[] = {0.0, 2.0, 4.0, 6.0, 8.0, 10.0};
constexpr double kOutlierRatios[] = {0.0, 0.1, 0.2, 0.3, 0.4, 0.5};
constexpr double kLineCounts[] = {4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0};

struct Sweep {
  SyntheticSweep sweep;
  std::string_view name;
  absl::Span<const double> values;
};
constexpr std::array kSweeps = {
    Sweep{SyntheticSweep::kNoise, "noise", kNoisesPx},
    Sweep{SyntheticSweep::kOutliers, "outliers", kOutlierRatios},
    Sweep{SyntheticSweep::kLines, "lines", kLineCounts},
};
static_assert(kSweeps.back().sweep == SyntheticSweep::kLines);
const Sweep& SweepOf(SyntheticSweep sweep) { return kSweeps[static_cast<size_t>(sweep)]; }

constexpr SyntheticMethod kMethods[] = {
    {"mixture", "normal about the line, the rest uniform: what evpose tracks with", LineFitMethod::kMixture,
     LineFitFormulas::kCorrected},
    {"ls", "least squares", LineFitMethod::kLeastSquares, LineFitFormulas::kCorrected},
    {"m", "the paper's M under its right formulas", LineFitMethod::kTukeyM, LineFitFormulas::kCorrected},
    {"s", "the paper's S under its right formulas", LineFitMethod::kTukeyS, LineFitFormulas::kCorrected},
    {"mm", "the paper's MM under its right formulas", LineFitMethod::kTukeyMm, LineFitFormulas::kCorrected},
    {"filter", "error-state Kalman filter, as in line-SLAM; with known noise", LineFitMethod::kErrorStateFilter,
     LineFitFormulas::kCorrected},
    {"ls-released", "least squares as the paper's released code computes", LineFitMethod::kLeastSquares,
     LineFitFormulas::kReleasedCode},
    {"m-released", "M as the paper's released code computes", LineFitMethod::kTukeyM, LineFitFormulas::kReleasedCode},
    {"s-released", "S as the paper's released code computes", LineFitMethod::kTukeyS, LineFitFormulas::kReleasedCode},
    {"mm-released", "MM as the paper's released code computes", LineFitMethod::kTukeyMm,
     LineFitFormulas::kReleasedCode},
};

absl::StatusOr<std::vector<SyntheticMethod>> ChosenMethods(const std::vector<std::string>& names) {
  return FindAllNamed(kMethods, names, "SyntheticBenchOptions.methods: there is no $0");
}

SyntheticTrialOptions TrialOptions(const SyntheticBenchOptions& options, SyntheticSweep sweep, double value) {
  SyntheticTrialOptions trial;
  trial.start_rotation_rad *= options.start_factor;
  trial.start_translation_ratio *= options.start_factor;
  if (sweep == SyntheticSweep::kNoise) trial.noise_px = value;
  if (sweep == SyntheticSweep::kOutliers) trial.outlier_ratio = value;
  if (sweep == SyntheticSweep::kLines) trial.num_lines = static_cast<int>(value);
  return trial;
}

struct ErrorLists {
  std::vector<double> rotations_deg;
  std::vector<double> translation_ratios;

  void Add(const SyntheticError& error) {
    rotations_deg.push_back(error.rotation_deg);
    translation_ratios.push_back(error.translation_ratio);
  }
  SyntheticErrors Summary() const {
    std::vector<double> rotations = rotations_deg;  // the medians reorder the copies
    std::vector<double> translations = translation_ratios;
    return {UpperMedian(rotations), Mean(rotations_deg), UpperMedian(translations), Mean(translation_ratios)};
  }
};

struct MethodResult {
  int num_none = 0;
  ErrorLists errors;
  std::vector<double> times_ms;
};

void RunMethod(const SyntheticMethod& method, const SyntheticTrial& trial, MethodResult& result) {
  LineFitOptions options;
  options.method = method.method;
  options.formulas = method.formulas;
  options.filter_sigma_px = std::max(trial.noise_px, kMinFilterSigmaPx);
  const auto begin = std::chrono::steady_clock::now();
  const absl::StatusOr<LineFit> fit = FitPoseToLines(trial.camera, trial.lines, trial.events, trial.start, options);
  result.times_ms.push_back(MillisecondsSince(begin));
  result.num_none += !fit.ok();
  result.errors.Add(CompareWithTruth(trial, fit.ok() ? fit->camera_from_object : trial.start));
}

absl::Status AddBound(const SyntheticTrial& trial, ErrorLists& errors) {
  EVPOSE_ASSIGN_OR_RETURN(const SyntheticBound bound, ComputeSyntheticBound(trial));
  errors.Add({bound.efficient_error.tail<3>().norm() * kDegreesPerRadian,
              bound.efficient_error.head<3>().norm() / trial.camera_from_object.translation_m.norm()});
  return absl::OkStatus();
}

// Runs all methods at one value; returning false from `on_trial` ends it.
absl::StatusOr<std::vector<SyntheticBenchRow>> RunValue(const SyntheticBenchOptions& options, SyntheticSweep sweep,
                                                        double value, absl::Span<const SyntheticMethod> methods,
                                                        const std::function<bool()>& on_trial) {
  const SyntheticTrialOptions trial_options = TrialOptions(options, sweep, value);
  std::vector<MethodResult> results(methods.size());
  ErrorLists bound;
  Random seeds(options.seed);
  for (int i = 0; i < options.num_trials; ++i) {
    const SyntheticTrial trial = MakeSyntheticTrial(trial_options, seeds.NextU64());
    if (trial.noise_px > 0.0) EVPOSE_RETURN_IF_ERROR(AddBound(trial, bound));
    for (size_t m = 0; m < methods.size(); ++m) RunMethod(methods[m], trial, results[m]);
    if (!on_trial()) return absl::CancelledError("interrupted");
  }
  std::vector<SyntheticBenchRow> rows;
  for (size_t m = 0; m < methods.size(); ++m) {
    SyntheticBenchRow& row = rows.emplace_back();
    row.sweep = sweep;
    row.value = value;
    row.method = methods[m].name;
    row.num_trials = options.num_trials;
    row.num_none = results[m].num_none;
    row.errors = results[m].errors.Summary();
    if (!bound.rotations_deg.empty()) row.bound = bound.Summary();
    row.median_ms = UpperMedian(results[m].times_ms);
  }
  return rows;
}

}  // namespace

std::string_view SyntheticSweepName(SyntheticSweep sweep) { return SweepOf(sweep).name; }

absl::StatusOr<SyntheticSweep> ParseSyntheticSweep(const std::string& name) {
  EVPOSE_ASSIGN_OR_RETURN(const Sweep found, FindNamed(kSweeps, name, "there is no sweep $0"));
  return found.sweep;
}

absl::Span<const double> SyntheticSweepValues(SyntheticSweep sweep) { return SweepOf(sweep).values; }

absl::Span<const SyntheticMethod> SyntheticMethods() { return kMethods; }

absl::Status SyntheticBenchOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("SyntheticBenchOptions.num_trials", num_trials, 1, 1'000'000));
  if (sweeps.empty()) return absl::InvalidArgumentError("SyntheticBenchOptions.sweeps is empty");
  EVPOSE_RETURN_IF_ERROR(CheckRange("SyntheticBenchOptions.start_factor", start_factor, 0.0, 100.0));
  return ChosenMethods(methods).status();
}

std::optional<double> SyntheticBenchRow::RotationRatio() const {
  if (!bound) return std::nullopt;
  return errors.rotation_median_deg / bound->rotation_median_deg;
}

std::optional<double> SyntheticBenchRow::TranslationRatio() const {
  if (!bound) return std::nullopt;
  return errors.translation_median_ratio / bound->translation_median_ratio;
}

absl::StatusOr<std::vector<SyntheticBenchRow>> RunSyntheticBench(
    const SyntheticBenchOptions& options, const std::function<void(const SyntheticBenchRow&)>& on_row,
    const std::function<bool(double)>& on_progress) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<SyntheticMethod> methods, ChosenMethods(options.methods));
  double num_trials = 0.0;
  for (const SyntheticSweep sweep : options.sweeps) {
    num_trials += options.num_trials * static_cast<double>(SyntheticSweepValues(sweep).size());
  }
  double num_done = 0.0;
  const auto on_trial = [&] { return !on_progress || on_progress(++num_done / num_trials); };
  std::vector<SyntheticBenchRow> rows;
  for (const SyntheticSweep sweep : options.sweeps) {
    for (const double value : SyntheticSweepValues(sweep)) {
      EVPOSE_ASSIGN_OR_RETURN(const std::vector<SyntheticBenchRow> more,
                              RunValue(options, sweep, value, methods, on_trial));
      for (const SyntheticBenchRow& row : more) {
        rows.push_back(row);
        if (on_row) on_row(row);
      }
    }
  }
  return rows;
}

}  // namespace evpose
