// SPDX-License-Identifier: Apache-2.0

// Benchmarks, for use with a profiler, of association and estimation, with the lines of a model and with 16 times as
// many.
//   build/release/tests/bench/tracking_benchmark --benchmark_filter=Estimate
#include <benchmark/benchmark.h>

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "core/experiments/speed/speed_windows.h"
#include "tests/bench/benchmark_recordings.h"

namespace evpose::bench {
namespace {

// Returns the windows of a scene, in which each line is divided into `num_pieces` lines. They are made once.
const SpeedWindows& WindowsOf(const std::string& scene, int num_pieces) {
  static std::map<std::pair<std::string, int>, SpeedWindows>* const all =
      new std::map<std::pair<std::string, int>, SpeedWindows>();
  const auto [found, is_new] = all->try_emplace({scene, num_pieces});
  if (is_new) {
    found->second = MakeSpeedWindows(RecordingOf(scene)).value();
    found->second.windows = WithCutLines(found->second.windows, num_pieces);
  }
  return found->second;
}

void CountLines(const SpeedWindows& made, benchmark::State& state) {
  size_t num_lines = 0;
  for (const SpeedWindow& window : made.windows) num_lines += window.lines.size();
  state.counters["lines"] = static_cast<double>(num_lines) / static_cast<double>(made.windows.size());
}

void Associate(benchmark::State& state, const std::string& scene, int num_pieces) {
  const SpeedWindows& made = WindowsOf(scene, num_pieces);
  WindowAssociation association(*made.context);
  size_t num_observed = 0;
  for ([[maybe_unused]] auto _ : state) {
    for (const SpeedWindow& window : made.windows) num_observed += association.Associate(window).events.size();
  }
  if (num_observed == 0) state.SkipWithError("no event is near a line");
  state.SetItemsProcessed(static_cast<int64_t>(state.iterations() * made.windows.size()));
  CountLines(made, state);
}

void Estimate(benchmark::State& state, const std::string& scene, int num_pieces) {
  const SpeedWindows& made = WindowsOf(scene, num_pieces);
  const std::vector<EstimationInput> inputs = MakeEstimationInputs(*made.context, made.windows);
  WindowFit fit;
  double num_explained = 0.0;
  for ([[maybe_unused]] auto _ : state) {
    const auto estimator = made.context->options.MakeEstimator(made.context->camera);
    for (const EstimationInput& window : inputs) {
      estimator->Fit(window.predicted, window.input, 1.0, fit);
      estimator->Accept(fit, window.input);
      num_explained += fit.num_explained;
    }
  }
  if (!(num_explained > 0.0)) state.SkipWithError("no event is attributed to a line");
  state.SetItemsProcessed(static_cast<int64_t>(state.iterations() * inputs.size()));
  CountLines(made, state);
}

BENCHMARK_CAPTURE(Associate, 1, "1", 1);
BENCHMARK_CAPTURE(Associate, 1_lines_x16, "1", 16);
BENCHMARK_CAPTURE(Associate, 10, "10", 1);
BENCHMARK_CAPTURE(Estimate, 1, "1", 1);
BENCHMARK_CAPTURE(Estimate, 1_lines_x16, "1", 16);
BENCHMARK_CAPTURE(Estimate, 10, "10", 1);

}  // namespace
}  // namespace evpose::bench

BENCHMARK_MAIN();
