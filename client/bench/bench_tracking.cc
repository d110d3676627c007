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
#include "client/bench/bench_tracking_output.h"
#include "client/cli/console/progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/experiments/tracking/tracking_bench.h"

namespace evpose::client {
namespace {

struct TrackingArguments {
  TrackingBenchOptions options;  // without the duration
  double duration_s = 0.0;
  std::string csv;
  std::string traces;
  bool is_json = false;
  bool is_list = false;
};

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
  TrackingBenchOptions options = arguments.options;
  options.max_duration_us = std::llround(arguments.duration_s * 1e6);
  EVPOSE_RETURN_IF_ERROR(AsUsageError(options.Validate()));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> csv, OpenOutput(arguments.csv));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> traces, OpenOutput(arguments.traces));
  if (traces) EVPOSE_RETURN_IF_ERROR(traces->Append(TrackingTraceHeader()));
  ProgressLine progress(context);
  std::vector<TrackingBenchBlock> blocks;
  absl::Status trace_status;
  const auto on_block = [&](const TrackingBenchBlock& block) {
    progress.Clear();
    if (!arguments.is_json) PrintTrackingBlock(block, options.num_paths, context.out);
    if (traces) trace_status.Update(traces->Append(TrackingTraces(block)));
    blocks.push_back(block);
    for (TrackingBenchRow& row : blocks.back().rows) row.scores.front().errors = {};
  };
  const auto on_progress = [&](double ratio, const std::string& text) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  %s", 100.0 * ratio, text));
    return !context.IsInterrupted();
  };
  EVPOSE_RETURN_IF_ERROR(RunTrackingBench(options, on_block, on_progress));
  EVPOSE_RETURN_IF_ERROR(trace_status);
  EVPOSE_RETURN_IF_ERROR(FinishOutput(traces, ""));
  EVPOSE_RETURN_IF_ERROR(FinishOutput(csv, TrackingCsv(blocks, options.num_paths)));
  if (arguments.is_json) context.out << TrackingJson(blocks, options).dump(2) << "\n";
  return absl::OkStatus();
}

std::string EstimatorList() {
  std::string text;
  for (const TrackingSubject& subject : TrackingSubjects()) {
    absl::StrAppend(&text, absl::StrFormat("  %-18s  %s\n", subject.name, subject.description));
  }
  return text;
}

}  // namespace

CommandRunner AddBenchTrackingCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<TrackingArguments>();
  app.option_defaults()->group(kExperimentGroup);
  app.add_flag("--list", arguments->is_list, "Print the scenarios, one on each line");
  AddNames(app, "--scenarios", arguments->options.scenarios, "Run only these scenarios");
  AddNames(app, "--estimators", arguments->options.estimators, "Run only these estimators");
  AddOption(app, "--seeds", arguments->options.num_seeds,
            "Number of seeds of the sensor, the noise and the textures of each scenario", NumberRange(1, 1000));
  AddOption(app, "--paths", arguments->options.num_paths, "Number of motions; each seed is run on each of them",
            NumberRange(1, 1000));
  AddOption(app, "--duration", arguments->duration_s,
            "Longest part of a recording that is used; 0: as long as the scenario is", NumberRange(0.0, 1800.0))
      ->type_name("SECONDS");
  app.add_option("--recordings", arguments->options.recordings,
                 "Directory where the simulated recordings are kept and used again")
      ->type_name("DIR");
  app.option_defaults()->group(kOutputGroup);
  AddOutputFile(app, "--csv", arguments->csv, "CSV with a line for each run; the file appears when it is complete");
  AddOutputFile(app, "--traces", arguments->traces,
                "CSV with poses and errors over time, of the first run of each scenario");
  AddJson(app, arguments->is_json, "Print one JSON object instead of text, at the end");
  app.footer(absl::StrCat(kTrackingTableHelp,
                          "tests/bench/plot.py draws the files of --json and --traces.\n\nEstimators:\n",
                          EstimatorList(),
                          "\nExample:\n"
                          "  evpose bench tracking --scenarios normal,half-out --seeds 1 --paths 1 --duration 0.2"));
  return [arguments, &context] { return RunTracking(*arguments, context); };
}

}  // namespace evpose::client
