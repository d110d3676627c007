// SPDX-License-Identifier: Apache-2.0

// evpose bench initialization: first poses by evpose and by published methods, on random trials.
#include <cmath>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/bench/bench.h"
#include "client/bench/bench_from_events.h"
#include "client/cli/common/table_cell.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/experiments/first_pose/initialization_bench.h"
#include "core/experiments/first_pose/initialization_methods.h"

namespace evpose::client {
namespace {

struct InitializationArguments {
  InitializationBenchOptions options;  // without the objects and the clutter
  std::vector<std::string> objects;
  std::vector<std::string> clutter;
  bool is_json = false;
  bool is_from_events = false;
  FromEventsArguments from_events;
};

// Parses "2/1": two spurious lines and one missing line.
absl::StatusOr<BenchClutter> ParseClutter(const std::string& text) {
  BenchClutter clutter;
  char slash = 0;
  std::istringstream stream(text);
  if (stream >> clutter.num_spurious >> slash >> clutter.num_missing && slash == '/' && stream.eof()) return clutter;
  return UsageError(absl::StrCat("--clutter ", text, ": must be SPURIOUS/MISSING, as in 2/1"));
}

absl::StatusOr<InitializationBenchOptions> MakeOptions(const InitializationArguments& arguments) {
  InitializationBenchOptions options = arguments.options;
  if (!arguments.objects.empty()) options.objects.clear();
  for (const std::string& name : arguments.objects) {
    const absl::StatusOr<SimulatedObject> object = ParseSimulatedObject(name);
    EVPOSE_RETURN_IF_ERROR(AsUsageError(object.status(), "--objects: "));
    options.objects.push_back(*object);
  }
  if (!arguments.clutter.empty()) options.clutter.clear();
  for (const std::string& text : arguments.clutter) {
    EVPOSE_ASSIGN_OR_RETURN(const BenchClutter clutter, ParseClutter(text));
    options.clutter.push_back(clutter);
  }
  EVPOSE_RETURN_IF_ERROR(AsUsageError(options.Validate()));
  return options;
}

Json RowJson(const InitializationBenchRow& row) {
  Json json = {{"object", SimulatedObjectName(row.object)},
               {"spurious", row.clutter.num_spurious},
               {"missing", row.clutter.num_missing},
               {"method", row.method},
               {"trials", row.num_trials},
               {"right", row.num_right},
               {"none", row.num_none},
               {"success_ratio", static_cast<double>(row.num_right) / row.num_trials}};
  // null without a right pose.
  json["reprojection_mean_right_px"] = row.reprojection_mean_right_px;
  json["reprojection_median_px"] = row.reprojection_median_px;
  json["reprojection_mean_px"] = row.reprojection_mean_px;
  json["median_ms"] = row.median_ms;
  json["worst_ms"] = row.worst_ms;
  if (row.certificates) {
    json["certificates"] = {{"maximum", row.certificates->num_maximum},
                            {"not_maximum", row.certificates->num_not_maximum},
                            {"unknown", row.certificates->num_unknown},
                            {"median_ms", row.certificates->median_ms}};
  }
  json["failed_seeds"] = row.failed_seeds;
  return json;
}

constexpr char kInitializationHeader[] =
    "object      clutter  method         trials  right %   reprojection px: right  median   mean    median ms  worst "
    "ms";
constexpr char kCertificateHeader[] = "   certified: maximum   not  unknown  median ms";

std::string CertificateCells(const InitializationBenchRow& row) {
  if (!row.certificates) return absl::StrFormat("   %18s %5s %8s %10s", "-", "-", "-", "-");
  const CertificateCounts& counts = *row.certificates;
  return absl::StrFormat("   %18d %5d %8d %10s", counts.num_maximum, counts.num_not_maximum, counts.num_unknown,
                         Cell(counts.median_ms, 3));
}

void PrintRow(const InitializationBenchRow& row, bool certifies, std::ostream& out) {
  const std::string clutter = absl::StrCat(row.clutter.num_spurious, "/", row.clutter.num_missing);
  out << absl::StrFormat("%-11s %-8s %-14s %6d  %7.1f   %22s %7s %7s %12.3f %9.3f%s\n",
                         std::string(SimulatedObjectName(row.object)), clutter, row.method, row.num_trials,
                         100.0 * row.num_right / row.num_trials, Cell(row.reprojection_mean_right_px, 2),
                         Cell(row.reprojection_median_px, 2), Cell(row.reprojection_mean_px, 2), row.median_ms,
                         row.worst_ms, certifies ? CertificateCells(row) : "");
  out.flush();
}

absl::Status RunInitialization(const InitializationArguments& arguments, CliContext& context) {
  if (arguments.is_from_events) {
    return RunFromEvents(arguments.from_events, arguments.objects, arguments.options.seed, arguments.is_json, context);
  }
  EVPOSE_ASSIGN_OR_RETURN(const InitializationBenchOptions options, MakeOptions(arguments));
  if (!arguments.is_json) context.out << kInitializationHeader << (options.certifies ? kCertificateHeader : "") << "\n";
  const auto on_row = [&](const InitializationBenchRow& row) {
    if (!arguments.is_json) PrintRow(row, options.certifies, context.out);
    return !context.IsInterrupted();
  };
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<InitializationBenchRow> rows, RunInitializationBench(options, on_row));
  if (!arguments.is_json) return absl::OkStatus();
  Json json = {
      {"trials", options.num_trials}, {"seed", options.seed}, {"noise_px", options.noise_px}, {"rows", Json::array()}};
  for (const InitializationBenchRow& row : rows) json["rows"].push_back(RowJson(row));
  context.out << json.dump(2) << "\n";
  return absl::OkStatus();
}

std::string PriorText(PriorKnowledge prior) {
  switch (prior) {
    case PriorKnowledge::kNothing:
      return "";
    case PriorKnowledge::kPosePrior:
      return "; given a pose nearby";
    case PriorKnowledge::kCorrespondences:
      return "; given the correspondences";
  }
  return "";
}

std::string InitializationMethodList() {
  std::string text;
  for (const InitializationMethod& method : InitializationMethods()) {
    absl::StrAppend(
        &text, absl::StrFormat("  %-14s %s%s\n", method.name, method.description, PriorText(method.prior_knowledge)));
  }
  return text;
}

constexpr char kAboutLines[] =
    "First poses from the lines of an object, with 0.8 px of noise at their end points. Every method gets the same\n"
    "lines. A pose is right within 2 degrees and 2 % of the depth, modulo the object's symmetries. Reprojection "
    "errors\n"
    "are those of the end points of the visible lines: mean of the right poses, median and mean of all poses.\n"
    "--certify searches by branch and bound for a better rotation than each pose of a method without given\n"
    "correspondences: maximum means a proof that no rotation matches more lines by direction.\n";
constexpr char kAboutEvents[] =
    "With --from-events the tracker is started at random times of a simulated recording of each object, without prior\n"
    "knowledge. A first pose counts as right if it is right and needs at most 50 ms of events, and as wrong at any "
    "time.\n"
    "The longest wrong is the longest time for which wrong poses were reported as TRACKING without a break.\n";

void AddLineOptions(CLI::App& app, InitializationArguments& arguments, CLI::Option* from_events) {
  app.option_defaults()->group("Experiment with lines");
  AddOption(app, "--trials", arguments.options.num_trials, "Number of random poses of each object and clutter",
            NumberRange(1, 1'000'000))
      ->excludes(from_events);
  AddNames(app, "--methods", arguments.options.methods, "Run only these methods")->excludes(from_events);
  app.add_option("--clutter", arguments.clutter, "Numbers of spurious and missing lines. Default: 0/0, 2/1 and 4/2")
      ->delimiter(',')
      ->excludes(from_events)
      ->type_name("N/N,...");
  app.add_flag("--all-trials", arguments.options.is_unlimited,
               "Run slow methods on all trials, not only on the first 100")
      ->excludes(from_events);
  app.add_flag("--certify", arguments.options.certifies,
               "Prove by branch and bound which rotations attain the maximum of the published objective")
      ->excludes(from_events);
}

}  // namespace

CommandRunner AddBenchInitializationCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<InitializationArguments>();
  app.option_defaults()->group(kExperimentGroup);
  app.add_option("--seed", arguments->options.seed, "Seed of the trials; the same seed gives the same trials")
      ->check(WholeNumber())
      ->capture_default_str();
  AddNames(app, "--objects", arguments->objects,
           "Use only these objects: " + absl::StrJoin(SimulatedObjectNames(), ", "));
  CLI::Option* from_events = app.add_flag("--from-events", arguments->is_from_events,
                                          "Use the events of simulated recordings instead of lines");
  AddJson(app, arguments->is_json);
  AddLineOptions(app, *arguments, from_events);
  arguments->from_events.AddTo(app, from_events);
  app.footer(absl::StrCat(kAboutLines, kAboutEvents, "\nMethods:\n", InitializationMethodList(),
                          "\nExample:\n"
                          "  evpose bench initialization --trials 5 --objects cube,planar --methods sqpnp,evpose "
                          "--certify\n"
                          "  evpose bench initialization --from-events --objects cube --camera vga --starts 3 "
                          "--duration 0.4 --returns 1\n"
                          "  evpose bench initialization --from-events --detector lsd --objects cube --camera vga "
                          "--starts 2 --duration 0.4 --returns 0"));
  return [arguments, &context] { return RunInitialization(*arguments, context); };
}

}  // namespace evpose::client
