// SPDX-License-Identifier: Apache-2.0

// The source paper's synthetic experiment (Sec. IV-A, Fig. 6): estimators of the pose on labelled events, under growing
// noise, with growing shares of outliers, with more and more lines; beside them the Cramer-Rao bound.
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

// What varies; the rest is as in SyntheticTrialOptions: 2 px, 2 %, 25 lines.
enum class SyntheticSweep { kNoise, kOutliers, kLines };

std::string_view SyntheticSweepName(SyntheticSweep sweep);  // noise, outliers, lines
// INVALID_ARGUMENT listing the names.
absl::StatusOr<SyntheticSweep> ParseSyntheticSweep(std::string_view name);
// Pixels, shares in [0, 1], or numbers of lines.
absl::Span<const double> SyntheticSweepValues(SyntheticSweep sweep);

struct SyntheticMethod {
  const char* name;
  const char* description;
  LineFitMethod method;
  LineFitFormulas formulas;
};
absl::Span<const SyntheticMethod> SyntheticMethods();

struct SyntheticBenchOptions {
  int num_trials = 1000;  // of each value of each sweep
  uint64_t seed = 1;      // the same seed gives the same trials, and as far as it goes the same for all values
  std::vector<SyntheticSweep> sweeps = {SyntheticSweep::kNoise, SyntheticSweep::kOutliers, SyntheticSweep::kLines};
  std::vector<std::string> methods;  // names; empty: all
  double start_factor = 1.0;         // on how far the start is from the truth (SyntheticTrialOptions)

  // INVALID_ARGUMENT naming the field, or a method that is not known.
  absl::Status Validate() const;
};

struct SyntheticErrors {
  double rotation_median_deg = 0.0;
  double rotation_mean_deg = 0.0;
  double translation_median_ratio = 0.0;  // of |T|
  double translation_mean_ratio = 0.0;
};

// One method at one value of a sweep.
struct SyntheticBenchRow {
  SyntheticSweep sweep = SyntheticSweep::kNoise;
  double value = 0.0;
  std::string method;
  int num_trials = 0;
  int num_none = 0;        // the method gave no pose: its error counts as that of the start, where a tracker would stay
  SyntheticErrors errors;  // of all trials
  // The efficient estimator's errors in the same trials, under the same noise (SyntheticBound::efficient_error); not
  // without noise, where there is no bound.
  std::optional<SyntheticErrors> bound;
  double median_ms = 0.0;  // wall clock, one core

  // Median error over the median of the bound's; without noise there is none.
  std::optional<double> RotationRatio() const;
  std::optional<double> TranslationRatio() const;
};

// In the order of sweeps, values and methods. All but the times is a function of the options. `on_row` is called after
// each row, `on_progress` after each trial with the share of all that is done: false stops, with CANCELLED. Errors
// otherwise as Validate().
absl::StatusOr<std::vector<SyntheticBenchRow>> RunSyntheticBench(
    const SyntheticBenchOptions& options, const std::function<void(const SyntheticBenchRow&)>& on_row,
    const std::function<bool(double)>& on_progress);

}  // namespace evpose
