// SPDX-License-Identifier: Apache-2.0

// evpose bench real: recordings of real sensors with references, and objects that are absent from them.
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/bench/bench.h"
#include "client/cli/common/table_cell.h"
#include "client/cli/console/progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/experiments/tracking/real_bench.h"
#include "core/experiments/tracking/real_check.h"

namespace evpose::client {
namespace {

struct RealArguments {
  RealBenchOptions options;  // without the duration and the parts
  RealLimits limits;         // of --check
  double duration_s = 2.0;
  std::string parts = "all";
  std::string out;
  bool is_checked = false;
};

struct RealResults {
  std::vector<RealBenchRow> rows;
  std::vector<ForeignBenchRow> foreign;
};

constexpr char kRealTableHelp[] =
    "DIR has a folder for each recording, with NAME.raw, model.obj, camera.yaml and a reference, NAME.tum or the only\n"
    "*.tum. A folder with recordings and without model.obj shows none of the objects. Each recording is tracked from\n"
    "several start times without a prior, and from the reference pose at the same times:\n"
    "  found     runs in which TRACKING was reported\n"
    "  wrong     runs whose first pose while TRACKING is wrong: the ends of the model's lines are projected more than\n"
    "            --bound-px from those of the reference (root mean square), modulo the symmetries of the model\n"
    "  wait      sensor time from the start until TRACKING was reported: median and longest, ms\n"
    "  compute   processor time until then, median, ms\n"
    "  longest   longest time for which TRACKING was reported with a wrong pose, ms\n"
    "  right     share of the time with a right pose in any state\n"
    "  doubtful  share of the time with poses in another state than TRACKING\n"
    "  ambig     the part of it with AMBIGUOUS poses\n"
    "  median, p95   error of the poses, px: median of the runs, and 95 % of the worst run\n"
    "  CPU       processor time per sensor time\n"
    "Then each object is searched for in each recording that does not show it, on a sensor of the same size, from\n"
    "--absent-starts start times to the end; TRACKING is an error there.\n";

constexpr char kRealHeader[] =
    "recording                 start      found  wrong     wait ms:  median  longest  compute ms  longest wrong ms  "
    "right %  doubtful %  ambig %  losses   error px: median    p95   CPU\n";

void PrintRuns(const std::string& name, const char* start, const std::vector<RealRun>& runs, std::ostream& out) {
  const RealSummary s = SummariseRealRuns(runs);
  out << absl::StrFormat("%-24s  %-9s %6s %6d %17s %8s %11s %17.0f %8.1f %11.1f %8.1f %7d %18s %6s %5s\n", name, start,
                         absl::StrCat(s.num_found, "/", runs.size()), s.num_wrong, Cell(1e3 * s.median_wait_s, 1),
                         Cell(1e3 * s.worst_wait_s, 1), Cell(1e3 * s.median_compute_s, 1), 1e3 * s.longest_wrong_s,
                         100.0 * s.right_ratio, 100.0 * s.doubtful_ratio, 100.0 * s.ambiguous_ratio, s.losses,
                         Cell(s.median_error_px, 2), Cell(s.p95_error_px, 2), Cell(s.compute_ratio, 2));
  out.flush();
}

void PrintForeign(const std::vector<ForeignBenchRow>& rows, std::ostream& out) {
  double searched_s = 0.0, compute_s = 0.0;
  size_t reported = 0;
  for (const ForeignBenchRow& row : rows) {
    searched_s += row.run.duration_s;
    compute_s += row.run.compute_s;
    if (!row.run.is_found()) continue;
    ++reported;
    out << absl::StrFormat(
        "absent: %s in %s, from %.3f s, is TRACKING for %.0f ms, for up to %.0f ms at a time, first after %.0f ms\n",
        row.object, row.recording, 1e-6 * static_cast<double>(row.run.start_us), 1e3 * row.run.tracking_s,
        1e3 * row.run.longest_wrong_s, 1e3 * row.run.wait_s);
  }
  out << absl::StrFormat("absent objects: TRACKING in %d of %d searches, %.1f s in all; processor time %s\n", reported,
                         rows.size(), searched_s, Cell(compute_s / searched_s, 2));
}

Json RunJson(const RealRun& run) {
  return {{"start_s", 1e-6 * static_cast<double>(run.start_us)},
          {"duration_s", run.duration_s},
          {"found", run.is_found()},
          {"wait_s", run.wait_s},
          {"compute_to_tracking_s", run.compute_to_tracking_s},
          {"compute_s", run.compute_s},
          {"first_error_px", run.first_error_px},
          {"first_wrong", run.is_first_wrong},
          {"right_ratio", run.right_ratio},
          {"doubtful_ratio", run.doubtful_ratio},
          {"ambiguous_ratio", run.ambiguous_ratio},
          {"motion_px", run.motion_px},
          {"tracking_s", run.tracking_s},
          {"wrong_tracking_s", run.wrong_s},
          {"longest_wrong_tracking_s", run.longest_wrong_s},
          {"median_error_px", run.median_error_px},
          {"p95_error_px", run.p95_error_px},
          {"losses", run.losses}};
}

Json RunsJson(const std::vector<RealRun>& runs) {
  const RealSummary s = SummariseRealRuns(runs);
  Json json = {{"starts", runs.size()},
               {"found", s.num_found},
               {"first_wrong", s.num_wrong},
               {"wait_median_s", s.median_wait_s},
               {"wait_longest_s", s.worst_wait_s},
               {"compute_median_s", s.median_compute_s},
               {"compute_ratio", s.compute_ratio},
               {"longest_wrong_tracking_s", s.longest_wrong_s},
               {"right_ratio", s.right_ratio},
               {"doubtful_ratio", s.doubtful_ratio},
               {"ambiguous_ratio", s.ambiguous_ratio},
               {"losses", s.losses},
               {"median_error_px", s.median_error_px},
               {"p95_error_px", s.p95_error_px},
               {"runs", Json::array()}};
  for (const RealRun& run : runs) json["runs"].push_back(RunJson(run));
  return json;
}

Json ResultsJson(const RealResults& results, const RealBenchOptions& options) {
  Json json = {{"starts", options.num_starts},
               {"duration_s", 1e-6 * static_cast<double>(options.max_duration_us)},
               {"bound_px", options.bound_px},
               {"recordings", Json::array()},
               {"absent", Json::array()}};
  for (const RealBenchRow& row : results.rows) {
    json["recordings"].push_back(
        {{"recording", row.recording}, {"searched", RunsJson(row.searched)}, {"given", RunsJson(row.given)}});
  }
  for (const ForeignBenchRow& row : results.foreign) {
    Json run = {{"object", row.object}, {"recording", row.recording}};
    run.update(RunJson(row.run));
    json["absent"].push_back(run);
  }
  return json;
}

// Error: FAILED_PRECONDITION with the first result that --check does not permit.
absl::Status CheckResults(const RealResults& results, const RealArguments& arguments) {
  RealLimits limits = arguments.limits;
  limits.min_motion_px = arguments.options.bound_px;
  absl::Status status;
  for (const RealBenchRow& row : results.rows) status.Update(CheckRealRow(row, limits));
  for (const ForeignBenchRow& row : results.foreign) status.Update(CheckForeignRow(row));
  return status.ok() ? status : absl::Status(status.code(), absl::StrCat("--check: ", status.message()));
}

absl::Status RunReal(const RealArguments& arguments, CliContext& context) {
  RealBenchOptions options = arguments.options;
  options.max_duration_us = std::llround(arguments.duration_s * 1e6);
  options.has_starts = arguments.parts != "absent";
  options.has_foreign = arguments.parts != "present";
  EVPOSE_RETURN_IF_ERROR(AsUsageError(options.Validate()));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> json, OpenOutput(arguments.out));
  ProgressLine progress(context);
  RealResults results;
  RealBenchListener listener;
  listener.on_row = [&](const RealBenchRow& row) {
    progress.Clear();
    if (results.rows.empty()) context.out << kRealHeader;
    PrintRuns(row.recording, "none", row.searched, context.out);
    PrintRuns(row.recording, "reference", row.given, context.out);
    results.rows.push_back(row);
  };
  listener.on_foreign = [&](const ForeignBenchRow& row) { results.foreign.push_back(row); };
  listener.on_progress = [&](double ratio, const std::string& text) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  %s", 100.0 * ratio, text));
    return !context.IsInterrupted();
  };
  EVPOSE_RETURN_IF_ERROR(RunRealBench(options, listener));
  progress.Clear();
  if (options.has_foreign) PrintForeign(results.foreign, context.out);
  EVPOSE_RETURN_IF_ERROR(FinishOutput(json, ResultsJson(results, options).dump(2) + "\n"));
  return arguments.is_checked ? CheckResults(results, arguments) : absl::OkStatus();
}

}  // namespace

CommandRunner AddBenchRealCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<RealArguments>();
  app.option_defaults()->group(kInputGroup);
  app.add_option("directory", arguments->options.directory, "Directory with a folder for each recording")
      ->type_name("DIR")
      ->required();
  AddNames(app, "--names", arguments->options.names, "Run only these recordings");
  app.option_defaults()->group(kExperimentGroup);
  AddOption(app, "--parts", arguments->parts,
            "present: recordings of the objects; absent: searches for objects that are not in view",
            CLI::IsMember({"all", "present", "absent"}));
  AddOption(app, "--starts", arguments->options.num_starts, "Number of start times of each recording",
            NumberRange(1, 1000));
  AddOption(app, "--absent-starts", arguments->options.num_absent_starts,
            "Number of start times of each search for an absent object", NumberRange(1, 1000));
  AddOption(app, "--duration", arguments->duration_s,
            "Longest time of a run from a start time; 0: to the end of the recording", NumberRange(0.0, 3600.0))
      ->type_name("SECONDS");
  AddOption(app, "--bound-px", arguments->options.bound_px, "Largest error of a right pose", NumberRange(0.01, 1000.0))
      ->type_name("PIXELS");
  app.option_defaults()->group(kOutputGroup);
  AddOutputFile(app, "-o,--out", arguments->out, "JSON with all runs; the file appears when it is complete");
  CLI::Option* const check =
      app.add_flag("--check", arguments->is_checked,
                   "End with status 1 if TRACKING was reported for more than 30 ms with a wrong pose of an object that "
                   "moves (by more than --bound-px in the run), with any wrong pose of an object at rest, or for an "
                   "absent object; or if a figure is below --min-found or --min-right");
  AddOption(app, "--min-found", arguments->limits.min_found_ratio,
            "Under --check: least share of the starts without a prior, of those in which the object moves, from which "
            "it is found with a right first pose",
            NumberRange(0.0, 1.0))
      ->type_name("RATIO")
      ->needs(check);
  AddOption(app, "--min-right", arguments->limits.min_right_ratio,
            "Under --check: least share of the time with a right pose, from the reference pose on, while the object "
            "moves",
            NumberRange(0.0, 1.0))
      ->type_name("RATIO")
      ->needs(check);
  app.footer(absl::StrCat(kRealTableHelp,
                          "\nExample:\n"
                          "  evpose simulate --object cube --camera vga --duration 0.2 --out recordings/cube\n"
                          "  evpose bench real recordings --starts 2 --duration 0.1"));
  return [arguments, &context] { return RunReal(*arguments, context); };
}

}  // namespace evpose::client
