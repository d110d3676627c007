// SPDX-License-Identifier: Apache-2.0

// evpose bench synthetic: the paper's synthetic experiment, as a table, CSV and JSON.
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "client/bench/bench.h"
#include "client/cli/console/progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/experiments/synthetic/synthetic_bench.h"

namespace evpose::client {
namespace {

struct SyntheticArguments {
  SyntheticBenchOptions options;
  std::vector<std::string> sweeps;
  std::string csv;
  bool is_json = false;
};

std::string ValueText(SyntheticSweep sweep, double value) {
  switch (sweep) {
    case SyntheticSweep::kNoise:
      return absl::StrFormat("%g px", value);
    case SyntheticSweep::kOutliers:
      return absl::StrFormat("%g %%", 100.0 * value);
    case SyntheticSweep::kLines:
      return absl::StrFormat("%g", value);
  }
  return "";
}

constexpr char kSyntheticHeader[] =
    "                           Err_R, deg                Err_T                  to the bound\n"
    "sweep      value  method        median       mean    median       mean        R        T   none  median ms\n";

std::string NameCells(SyntheticSweep sweep, double value, const std::string& method) {
  return absl::StrFormat("%-9s %6s  %-11s", std::string(SyntheticSweepName(sweep)), ValueText(sweep, value), method);
}

std::string ErrorCells(const SyntheticErrors& errors) {
  return absl::StrFormat(" %9.3g  %9.3g %9.3g  %9.3g", errors.rotation_median_deg, errors.rotation_mean_deg,
                         errors.translation_median_ratio, errors.translation_mean_ratio);
}

std::string RatioCell(const std::optional<double>& ratio) {
  return ratio ? absl::StrFormat("%8.3f", *ratio) : absl::StrFormat("%8s", "-");
}

void PrintRow(const SyntheticBenchRow& row, std::ostream& out) {
  out << NameCells(row.sweep, row.value, row.method) << ErrorCells(row.errors)
      << absl::StrFormat(" %s %s %6d %10.2f\n", RatioCell(row.RotationRatio()), RatioCell(row.TranslationRatio()),
                         row.num_none, row.median_ms);
}

void PrintBound(const SyntheticBenchRow& row, std::ostream& out) {
  if (row.bound) out << NameCells(row.sweep, row.value, "bound") << ErrorCells(*row.bound) << "\n";
}

// Without noise there is no bound: null.
Json OptionalJson(const std::optional<double>& value) { return value ? Json(*value) : Json(); }

Json ErrorsJson(const SyntheticErrors& errors) {
  return {{"rotation_median_deg", errors.rotation_median_deg},
          {"rotation_mean_deg", errors.rotation_mean_deg},
          {"translation_median_ratio", errors.translation_median_ratio},
          {"translation_mean_ratio", errors.translation_mean_ratio}};
}

Json RowJson(const SyntheticBenchRow& row) {
  Json json = {{"sweep", SyntheticSweepName(row.sweep)},
               {"value", row.value},
               {"method", row.method},
               {"trials", row.num_trials},
               {"none", row.num_none}};
  json.update(ErrorsJson(row.errors));
  json["bound"] = row.bound ? ErrorsJson(*row.bound) : Json();
  json["rotation_to_bound"] = OptionalJson(row.RotationRatio());
  json["translation_to_bound"] = OptionalJson(row.TranslationRatio());
  json["median_ms"] = row.median_ms;
  return json;
}

std::string CsvText(const std::vector<SyntheticBenchRow>& rows) {
  const auto optional = [](const std::optional<double>& value) {
    return value ? absl::StrFormat("%.9g", *value) : std::string();
  };
  std::string text =
      "sweep,value,method,trials,none,rotation_median_deg,rotation_mean_deg,translation_median_ratio,"
      "translation_mean_ratio,bound_rotation_median_deg,bound_translation_median_ratio,rotation_to_bound,"
      "translation_to_bound,median_ms\n";
  for (const SyntheticBenchRow& row : rows) {
    std::optional<double> bound_deg, bound_ratio;
    if (row.bound) {
      bound_deg = row.bound->rotation_median_deg;
      bound_ratio = row.bound->translation_median_ratio;
    }
    absl::StrAppendFormat(&text, "%s,%g,%s,%d,%d,%.9g,%.9g,%.9g,%.9g,%s,%s,%s,%s,%.4g\n",
                          std::string(SyntheticSweepName(row.sweep)), row.value, row.method, row.num_trials,
                          row.num_none, row.errors.rotation_median_deg, row.errors.rotation_mean_deg,
                          row.errors.translation_median_ratio, row.errors.translation_mean_ratio, optional(bound_deg),
                          optional(bound_ratio), optional(row.RotationRatio()), optional(row.TranslationRatio()),
                          row.median_ms);
  }
  return text;
}

absl::StatusOr<SyntheticBenchOptions> MakeOptions(const SyntheticArguments& arguments) {
  SyntheticBenchOptions options = arguments.options;
  if (!arguments.sweeps.empty()) options.sweeps.clear();
  for (const std::string& name : arguments.sweeps) {
    const absl::StatusOr<SyntheticSweep> sweep = ParseSyntheticSweep(name);
    EVPOSE_RETURN_IF_ERROR(AsUsageError(sweep.status(), "--sweeps: "));
    options.sweeps.push_back(*sweep);
  }
  if (const absl::Status status = options.Validate(); !status.ok()) {
    return UsageError(absl::StrReplaceAll(status.message(), {{"SyntheticBenchOptions.", "--"}}));
  }
  return options;
}

absl::StatusOr<std::vector<SyntheticBenchRow>> RunTrials(const SyntheticBenchOptions& options, bool prints,
                                                         CliContext& context) {
  ProgressLine progress(context);
  std::optional<SyntheticBenchRow> last;
  if (prints) context.out << kSyntheticHeader;
  const auto on_row = [&](const SyntheticBenchRow& row) {
    if (!prints) return;
    progress.Clear();
    if (last && (last->sweep != row.sweep || last->value != row.value)) PrintBound(*last, context.out);
    PrintRow(row, context.out);
    context.out.flush();
    last = row;
  };
  const auto on_progress = [&](double ratio) {
    progress.Show(ratio, absl::StrFormat("%3.0f %% of the trials", 100.0 * ratio));
    return !context.IsInterrupted();
  };
  EVPOSE_ASSIGN_OR_RETURN(std::vector<SyntheticBenchRow> rows, RunSyntheticBench(options, on_row, on_progress));
  if (last) PrintBound(*last, context.out);
  return rows;
}

absl::Status RunSynthetic(const SyntheticArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const SyntheticBenchOptions options, MakeOptions(arguments));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> csv, OpenOutput(arguments.csv));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<SyntheticBenchRow> rows, RunTrials(options, !arguments.is_json, context));
  EVPOSE_RETURN_IF_ERROR(FinishOutput(csv, CsvText(rows)));
  if (!arguments.is_json) return absl::OkStatus();
  Json json = {{"trials", options.num_trials},
               {"seed", options.seed},
               {"start_factor", options.start_factor},
               {"rows", Json::array()}};
  for (const SyntheticBenchRow& row : rows) json["rows"].push_back(RowJson(row));
  context.out << json.dump(2) << "\n";
  return absl::OkStatus();
}

constexpr char kAbout[] =
    "Random lines 5 to 10 m in front of a camera of 640x480 pixels with f = 800 px; 100 events per line, some of "
    "which\n"
    "are attributed to a wrong line (Fig. 6 of the source paper). Every method gets the same events and the same "
    "start:\n"
    "the truth, rotated by up to 0.02 rad about each axis and moved by up to 1 % of |T| along it. Constant parameters\n"
    "are 25 lines, 2 px of noise and 2 % of outliers. Err_T is |T - T'| / |T|. The bound is the Cramer-Rao bound: the\n"
    "errors of the efficient estimator in the same trials under the same noise if the outliers are known. Ratios are "
    "of\n"
    "medians. none: number of fits without a pose; they count as the start.\n"
    "tests/bench/plot.py draws the output of --json.\n";

std::string SyntheticMethodList() {
  std::string text;
  for (const SyntheticMethod& method : SyntheticMethods()) {
    absl::StrAppend(&text, absl::StrFormat("  %-12s %s\n", method.name, method.description));
  }
  return text;
}

}  // namespace

CommandRunner AddBenchSyntheticCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<SyntheticArguments>();
  SyntheticBenchOptions& options = arguments->options;
  app.option_defaults()->group(kExperimentGroup);
  AddOption(app, "--trials", options.num_trials, "Number of trials of each value of each sweep",
            NumberRange(1, 1'000'000));
  app.add_option("--seed", options.seed, "Seed of the trials; the same seed gives the same trials")
      ->check(WholeNumber())
      ->capture_default_str();
  AddNames(app, "--sweeps", arguments->sweeps, "Run only these sweeps: noise, outliers, lines");
  AddNames(app, "--methods", options.methods, "Run only these methods");
  AddOption(app, "--start-factor", options.start_factor, "Factor on the distance of the start from the truth",
            NumberRange(0.0, 100.0))
      ->type_name("FACTOR");
  AddOutputFile(app, "--csv", arguments->csv, "CSV with the table; the file appears when it is complete")
      ->group(kOutputGroup);
  AddJson(app, arguments->is_json);
  app.footer(absl::StrCat(kAbout, "\nMethods:\n", SyntheticMethodList(),
                          "\nExample:\n"
                          "  evpose bench synthetic --trials 10 --methods mixture,mm,ls --csv synthetic.csv"));
  return [arguments, &context] { return RunSynthetic(*arguments, context); };
}

}  // namespace evpose::client
