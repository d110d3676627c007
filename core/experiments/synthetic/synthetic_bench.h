// SPDX-License-Identifier: Apache-2.0

// The synthetic experiment of the paper (Sec. IV-A, Fig. 6): pose estimators on labelled events, with increasing noise,
// outlier ratio and number of lines, compared with the Cramer-Rao bound (core/experiments/README.md, section 2).
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/estimators/line_fit.h"
#include "core/experiments/synthetic/synthetic_trial.h"

namespace evpose {

// The parameter that varies; the others are those of SyntheticTrialOptions: 2 px, 2 %, 25 lines.
enum class SyntheticSweep { kNoise, kOutliers, kLines };

std::string_view SyntheticSweepName(SyntheticSweep sweep);  // noise, outliers, lines
// INVALID_ARGUMENT lists the names.
absl::StatusOr<SyntheticSweep> ParseSyntheticSweep(const std::string& name);
// Values of the parameter: pixels, ratios in [0, 1], or numbers of lines.
absl::Span<const double> SyntheticSweepValues(SyntheticSweep sweep);

struct SyntheticMethod {
  const char* name;
  const char* description;
  LineFitMethod method;
  LineFitFormulas formulas;
};
absl::Span<const SyntheticMethod> SyntheticMethods();

struct SyntheticBenchOptions {
  int num_trials = 1000;  // trials for each value of each sweep
  // Equal seeds give equal trials; different values use the same random numbers as far as possible.
  uint64_t seed = 1;
  std::vector<SyntheticSweep> sweeps = {SyntheticSweep::kNoise, SyntheticSweep::kOutliers, SyntheticSweep::kLines};
  std::vector<std::string> methods;  // names of SyntheticMethods(); empty: all
  double start_factor = 1.0;         // factor on the deviation of the start from the truth (SyntheticTrialOptions)

  // INVALID_ARGUMENT names the field or an unknown method.
  absl::Status Validate() const;
};

struct SyntheticErrors {
  double rotation_median_deg = 0.0;
  double rotation_mean_deg = 0.0;
  double translation_median_ratio = 0.0;  // relative to |T|
  double translation_mean_ratio = 0.0;
};

// One method at one value of a sweep.
struct SyntheticBenchRow {
  SyntheticSweep sweep = SyntheticSweep::kNoise;
  double value = 0.0;
  std::string method;
  int num_trials = 0;
  // Trials in which the method gave no pose: their error is that of the start, which a tracker would keep.
  int num_none = 0;
  SyntheticErrors errors;  // errors of all trials
  // Errors of the efficient estimator in the same trials with the same noise (SyntheticBound::efficient_error). nullopt
  // without noise, where there is no bound.
  std::optional<SyntheticErrors> bound;
  double median_ms = 0.0;  // milliseconds of wall clock on one core

  // Median error divided by that of the bound; nullopt without noise.
  std::optional<double> RotationRatio() const;
  std::optional<double> TranslationRatio() const;
};

// Runs the experiment; the rows are in the order of sweeps, values and methods. All but the times is a function of the
// options. `on_row` is called after each row, `on_progress` after each trial with the finished share of the work;
// returning false ends it with CANCELLED. Other errors: those of Validate().
absl::StatusOr<std::vector<SyntheticBenchRow>> RunSyntheticBench(
    const SyntheticBenchOptions& options, const std::function<void(const SyntheticBenchRow&)>& on_row,
    const std::function<bool(double)>& on_progress);

}  // namespace evpose
