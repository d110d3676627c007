// SPDX-License-Identifier: Apache-2.0

// evpose bench tracking: the tracker and the published estimators on simulated recordings.
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/bench/bench.h"
#include "client/bench/bench_tracking_charts.h"
#include "client/bench/bench_tracking_files.h"
#include "client/bench/bench_tracking_table.h"
#include "client/cli/common/progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/experiments/tracking/tracking_bench.h"

namespace evpose::client {
namespace {

struct TrackingArguments {
  std::vector<std::string> scenarios;
  std::vector<std::string> estimators;
  int num_seeds = 5;
  int num_paths = 5;
  double duration_s = 0.0;
  std::string recordings;
  std::string csv;
  std::string charts;
  bool is_json = false;
  bool is_list = false;
};

absl::StatusOr<TrackingBenchOptions> MakeOptions(const TrackingArguments& arguments) {
  TrackingBenchOptions options;
  options.scenarios = arguments.scenarios;
  options.estimators = arguments.estimators;
  options.num_seeds = arguments.num_seeds;
  options.num_paths = arguments.num_paths;
  options.recordings = arguments.recordings;
  options.max_duration_us = std::llround(arguments.duration_s * 1e6);
  if (const absl::Status status = options.Validate(); !status.ok()) return UsageError(std::string(status.message()));
  return options;
}

void PrintScenarios(std::ostream& out) {
  for (const TrackingScenario& scenario : TrackingScenarios()) {
    const SimulationOptions& options = scenario.simulation;
    out << absl::StrFormat("%-20s %4dx%d  %4.0f s  %s\n", scenario.name, options.camera.width_px,
                           options.camera.height_px, 1e-6 * static_cast<double>(options.duration_us),
                           scenario.description);
  }
}

absl::Status RunTracking(const TrackingArguments& arguments, CliContext& context) {
  if (arguments.is_list) {
    PrintScenarios(context.out);
    return absl::OkStatus();
  }
  EVPOSE_ASSIGN_OR_RETURN(const TrackingBenchOptions options, MakeOptions(arguments));
  // What cannot be written is said before the work, not after it.
  std::optional<OutputFile> csv;
  std::optional<TrackingCharts> charts;
  if (!arguments.csv.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(csv, OutputFile::Create(arguments.csv));
  }
  if (!arguments.charts.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(charts, TrackingCharts::Create(arguments.charts));
  }
  ProgressLine progress(context);
  std::vector<TrackingBenchBlock> blocks;
  absl::Status chart_status;
  const auto on_block = [&](const TrackingBenchBlock& block) {
    progress.Clear();
    if (!arguments.is_json) PrintTrackingBlock(block, options.num_paths, context.out);
    if (charts) chart_status.Update(charts->Write(block));
    blocks.push_back(block);
    for (TrackingBenchRow& row : blocks.back().rows) row.scores.front().errors = {};  // drawn
  };
  const auto on_progress = [&](double ratio, const std::string& text) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  %s", 100.0 * ratio, text));
    return !context.IsInterrupted();
  };
  EVPOSE_RETURN_IF_ERROR(RunTrackingBench(options, on_block, on_progress));
  EVPOSE_RETURN_IF_ERROR(chart_status);
  if (charts) EVPOSE_RETURN_IF_ERROR(charts->WriteSummary(blocks));
  if (csv) {
    EVPOSE_RETURN_IF_ERROR(csv->Append(TrackingCsv(blocks, options.num_paths)));
    EVPOSE_RETURN_IF_ERROR(csv->Commit());
  }
  if (arguments.is_json) context.out << TrackingJson(blocks, options).dump(2) << "\n";
  return absl::OkStatus();
}

std::string EstimatorList() {
  std::string text;
  for (const TrackingSubject& subject : TrackingSubjects()) {
    absl::StrAppend(&text, absl::StrFormat("  %-14s %s\n", subject.name, subject.description));
  }
  return text;
}

}  // namespace

CommandRunner AddBenchTrackingCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<TrackingArguments>();
  app.add_flag("--list", arguments->is_list, "The scenarios, one a line");
  app.add_option("--scenarios", arguments->scenarios, "Some of them")->delimiter(',')->type_name("NAME,...");
  app.add_option("--estimators", arguments->estimators, "Some of those below")->delimiter(',')->type_name("NAME,...");
  app.add_option("--seeds", arguments->num_seeds, "Sensors, noises and textures of each scenario")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--paths", arguments->num_paths, "Motions; each seed is run on each of them")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--duration", arguments->duration_s, "Seconds that a recording has at most; 0: the scenario's own")
      ->check(CLI::Range(0.0, 1800.0))
      ->capture_default_str();
  app.add_option("--recordings", arguments->recordings,
                 "Keeps the recordings below this directory, and uses those that are there again")
      ->type_name("DIR");
  app.add_option("--csv", arguments->csv, "A line for each run as a file; written whole or not at all")
      ->type_name("FILE");
  app.add_option("--plots", arguments->charts,
                 "Draws each scenario's first run and a summary of all into this directory; needs the program gnuplot")
      ->type_name("DIR");
  app.add_flag("--json", arguments->is_json, "One JSON object on standard output, at the end");
  app.footer(absl::StrCat(kTrackingTableHelp, "\nEstimators:\n", EstimatorList(),
                          "\nExample:\n"
                          "  evpose bench tracking --scenarios normal,half-out --seeds 1 --paths 1 --duration 0.2"));
  return [arguments, &context] { return RunTracking(*arguments, context); };
}

}  // namespace evpose::client
