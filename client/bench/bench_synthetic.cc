// SPDX-License-Identifier: Apache-2.0

// evpose bench synthetic: the paper's synthetic experiment, as a table, CSV, JSON and a picture.
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/bench/bench.h"
#include "client/bench/chart.h"
#include "client/cli/common/progress.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/experiments/synthetic/synthetic_bench.h"

namespace evpose::client {
namespace {

struct SyntheticArguments {
  SyntheticBenchOptions options;
  std::vector<std::string> sweeps;
  std::string csv;
  std::string picture;
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
  Json json;
  json["sweep"] = SyntheticSweepName(row.sweep);
  json["value"] = row.value;
  json["method"] = row.method;
  json["trials"] = row.num_trials;
  json["none"] = row.num_none;
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

// A row of the picture: one number of each row of the table, and of its bound.
struct Figure {
  const char* title;
  const char* label;
  double SyntheticErrors::*error;
  bool is_to_bound = false;
};
constexpr Figure kFigures[] = {
    {"Median rotation error", "Err_R, deg", &SyntheticErrors::rotation_median_deg},
    {"Mean rotation error", "Err_R, deg", &SyntheticErrors::rotation_mean_deg},
    {"Median translation error", "Err_T", &SyntheticErrors::translation_median_ratio},
    {"Mean translation error", "Err_T", &SyntheticErrors::translation_mean_ratio},
    {"Median rotation error to the bound's", "ratio", &SyntheticErrors::rotation_median_deg, true},
    {"Median translation error to the bound's", "ratio", &SyntheticErrors::translation_median_ratio, true},
};

ChartAxis SweepAxis(SyntheticSweep sweep) {
  switch (sweep) {
    case SyntheticSweep::kNoise:
      return {.label = "noise, px"};
    case SyntheticSweep::kOutliers:
      return {.label = "outliers, %"};
    case SyntheticSweep::kLines:
      return {.label = "lines"};
  }
  return {};
}

// The released code's variant of a method has its colour, hollow markers and dashes.
ChartSeries MethodSeries(size_t method) {
  constexpr int kNumMarkers = 7;
  const absl::Span<const SyntheticMethod> methods = SyntheticMethods();
  const bool is_released = methods[method].formulas == LineFitFormulas::kReleasedCode;
  size_t color = method;
  for (size_t i = 0; i < method && is_released; ++i) {
    if (methods[i].method == methods[method].method) color = std::min(color, i);
  }
  ChartSeries series;
  series.name = methods[method].name;
  series.style = ChartStyle::kLinesAndPoints;
  series.color = static_cast<int>(color);
  series.marker = static_cast<int>(color) % kNumMarkers + (is_released ? kNumMarkers : 0);
  series.is_dashed = is_released;
  return series;
}

// The points of a figure: those of a method, or of the bound without one.
void AddPoint(const SyntheticBenchRow& row, const Figure& figure, const SyntheticErrors& errors, ChartSeries& series) {
  const double x = row.sweep == SyntheticSweep::kOutliers ? 100.0 * row.value : row.value;
  if (!series.x.empty() && series.x.back() == x) return;  // the bound is the same for all methods
  series.x.push_back(x);
  series.y.push_back(errors.*figure.error / (figure.is_to_bound ? (*row.bound).*figure.error : 1.0));
}

ChartPanel MakePanel(const std::vector<SyntheticBenchRow>& rows, SyntheticSweep sweep, const Figure& figure) {
  // Beyond it is what does not come near the bound at all: least squares.
  constexpr double kHighestRatio = 2.6;
  ChartPanel panel;
  panel.title = figure.title;
  panel.x_axis = SweepAxis(sweep);
  panel.x_axis.min = 0.0;
  panel.y_axis.label = figure.label;
  panel.y_axis.is_logarithmic = !figure.is_to_bound;
  ChartSeries bound;
  bound.name = "Cramer-Rao bound";
  bound.color = 6;
  bound.is_dashed = true;
  std::map<std::string, ChartSeries> series;
  for (const SyntheticBenchRow& row : rows) {
    if (row.sweep != sweep || (figure.is_to_bound && !row.bound)) continue;
    AddPoint(row, figure, row.errors, series[row.method]);
    if (row.bound) AddPoint(row, figure, *row.bound, bound);
  }
  for (size_t m = 0; m < SyntheticMethods().size(); ++m) {
    const auto points = series.find(SyntheticMethods()[m].name);
    if (points == series.end()) continue;
    panel.series.push_back(MethodSeries(m));
    panel.series.back().x = points->second.x;
    panel.series.back().y = points->second.y;
  }
  // Without noise the errors are those of rounding, or next to nothing: far below what the panel is about.
  if (!bound.y.empty()) panel.y_axis.min = 0.5 * *std::min_element(bound.y.begin(), bound.y.end());
  if (figure.is_to_bound) panel.y_axis.max = kHighestRatio;
  panel.series.push_back(std::move(bound));
  return panel;
}

// A column for each of the paper's three sweeps, rotation above translation, and what remains to the bound.
ChartPage MakePage(const SyntheticBenchOptions& options, const std::vector<SyntheticBenchRow>& rows) {
  ChartPage page;
  page.title = absl::StrCat("Pose from labelled events: ", options.num_trials, " trials, seed ", options.seed);
  page.num_columns = static_cast<int>(options.sweeps.size());
  page.panel_height_px = 260;
  for (const Figure& figure : kFigures) {
    for (const SyntheticSweep sweep : options.sweeps) page.panels.push_back(MakePanel(rows, sweep, figure));
  }
  return page;
}

absl::StatusOr<SyntheticBenchOptions> MakeOptions(const SyntheticArguments& arguments) {
  SyntheticBenchOptions options = arguments.options;
  if (!arguments.sweeps.empty()) options.sweeps.clear();
  for (const std::string& name : arguments.sweeps) {
    const absl::StatusOr<SyntheticSweep> sweep = ParseSyntheticSweep(name);
    if (!sweep.ok()) return UsageError(absl::StrCat("--sweeps: ", sweep.status().message()));
    options.sweeps.push_back(*sweep);
  }
  if (const absl::Status status = options.Validate(); !status.ok()) return UsageError(std::string(status.message()));
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
  // What cannot be written is said before the work, not after it.
  std::optional<OutputFile> csv;
  std::optional<ChartFile> picture;
  if (!arguments.csv.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(csv, OutputFile::Create(arguments.csv));
  }
  if (!arguments.picture.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(picture, ChartFile::Create(arguments.picture));
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<SyntheticBenchRow> rows, RunTrials(options, !arguments.is_json, context));
  if (csv) {
    EVPOSE_RETURN_IF_ERROR(csv->Append(CsvText(rows)));
    EVPOSE_RETURN_IF_ERROR(csv->Commit());
  }
  if (picture) EVPOSE_RETURN_IF_ERROR(picture->Write(MakePage(options, rows)));
  if (!arguments.is_json) return absl::OkStatus();
  Json json;
  json["trials"] = options.num_trials;
  json["seed"] = options.seed;
  json["start_factor"] = options.start_factor;
  json["rows"] = Json::array();
  for (const SyntheticBenchRow& row : rows) json["rows"].push_back(RowJson(row));
  context.out << json.dump(2) << "\n";
  return absl::OkStatus();
}

constexpr char kAbout[] =
    "Random lines 5 to 10 m before a camera of 640x480 with f = 800, 100 events about each, some of them with the "
    "wrong\n"
    "line: as the source paper's Fig. 6. Every method gets the same events and the same start, the truth moved by up "
    "to\n"
    "0.02 rad about and 1 % of |T| along each axis. 25 lines, 2 px and 2 % where they do not vary. Err_T is |T - T'| / "
    "|T|.\n"
    "The bound is Cramer and Rao's: the errors that the efficient estimator makes in the same trials under the same\n"
    "noise when it is told which events are outliers; ratios are of medians. none: fits that gave no pose, and count\n"
    "as the start.\n";

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
  app.add_option("--trials", options.num_trials, "Trials of each value of each sweep")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option("--seed", options.seed, "The same seed gives the same trials")->capture_default_str();
  app.add_option("--sweeps", arguments->sweeps, "Some of noise, outliers, lines")
      ->delimiter(',')
      ->type_name("NAME,...");
  app.add_option("--methods", options.methods, "Some of the methods below")->delimiter(',')->type_name("NAME,...");
  app.add_option("--start-factor", options.start_factor, "On how far the start is from the truth")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str();
  app.add_option("--csv", arguments->csv, "The table as a file; written whole or not at all")->type_name("FILE");
  app.add_option("--picture", arguments->picture, "The errors drawn: .png or .svg; needs the program gnuplot")
      ->type_name("FILE");
  app.add_flag("--json", arguments->is_json, "One JSON object on standard output");
  app.footer(absl::StrCat(kAbout, "\nMethods:\n", SyntheticMethodList(),
                          "\nExample:\n"
                          "  evpose bench synthetic --trials 10 --methods mixture,mm,ls --csv synthetic.csv --picture "
                          "synthetic.png"));
  return [arguments, &context] { return RunSynthetic(*arguments, context); };
}

}  // namespace evpose::client
