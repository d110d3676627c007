// SPDX-License-Identifier: Apache-2.0

// evpose bench models: preparation of model files, tracking from the true pose, and first poses without a prior.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/bench/bench.h"
#include "client/bench/bench_first_pose_output.h"
#include "client/bench/bench_models_output.h"
#include "client/cli/console/progress.h"
#include "client/model_intake/model_intake.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "core/simulation/simulator.h"

namespace evpose::client {
namespace {

namespace fs = std::filesystem;

struct ModelsArguments {
  ModelBenchOptions options;  // without the models and the duration
  std::string directory;
  std::vector<std::string> names;
  double duration_s = 1.5;
  double metres_per_unit = 1.0;
  std::string scene{ModelBenchSceneName(ModelBenchScene::kStandard)};
  bool is_first_pose = false;
  FirstPoseBenchOptions first_pose;  // only num_starts and explains are used
  std::string shown;                 // name of the model in the recordings of --first-pose; empty: those of `names`
  std::optional<double> watch_s;
  std::string out;
};

constexpr double kWatchS = 0.4;  // default of --watch, in seconds, unless the recordings are shorter
constexpr const char* kListName = "models.json";

// The entries of models.json, which tests/bench/models/generate.py writes.
absl::StatusOr<std::vector<BenchModel>> ReadList(const fs::path& directory) {
  constexpr size_t kMaxListBytes = 1 << 22;  // bounds memory; an entry has some hundred bytes
  const std::string path = (directory / kListName).string();
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxListBytes));
  const Json list = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  const auto error = [&path](size_t entry, const char* field) {
    return absl::InvalidArgumentError(absl::StrFormat("%s: entry %d has no valid \"%s\"", path, entry, field));
  };
  if (!list.is_array()) return absl::InvalidArgumentError(absl::StrCat(path, ": must be a JSON array of models"));
  std::vector<BenchModel> models;
  for (const Json& entry : list) {
    for (const char* field : {"name", "file", "reference"}) {
      if (!entry.is_object() || !entry.contains(field) || !entry[field].is_string()) return error(models.size(), field);
    }
    if (!entry.contains("metres_per_unit") || !entry["metres_per_unit"].is_number()) {
      return error(models.size(), "metres_per_unit");
    }
    models.push_back({entry["name"].get<std::string>(), (directory / entry["file"].get<std::string>()).string(),
                      entry["metres_per_unit"].get<double>(),
                      (directory / entry["reference"].get<std::string>()).string()});
  }
  return models;
}

// All model files of a directory, by name; each is its own reference.
absl::StatusOr<std::vector<BenchModel>> FindFiles(const fs::path& directory, double metres_per_unit) {
  std::error_code error;
  std::vector<BenchModel> models;
  for (fs::directory_iterator entry(directory, error), end; !error && entry != end; entry.increment(error)) {
    const fs::path& path = entry->path();
    if (!IsModelFile(path.string())) continue;
    models.push_back({path.filename().string(), path.string(), metres_per_unit, ""});
  }
  if (error) return absl::NotFoundError(absl::StrCat(directory.string(), ": ", error.message()));
  std::sort(models.begin(), models.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  return models;
}

absl::StatusOr<std::vector<BenchModel>> FindAllModels(const ModelsArguments& arguments) {
  const fs::path directory = arguments.directory;
  std::error_code error;
  const bool has_list = fs::exists(directory / kListName, error);
  EVPOSE_ASSIGN_OR_RETURN(std::vector<BenchModel> models,
                          has_list ? ReadList(directory) : FindFiles(directory, arguments.metres_per_unit));
  if (models.empty()) return UsageError(absl::StrCat("--models ", arguments.directory, ": has no model file"));
  return models;
}

// Returns the model of this name; usage error, with the name of the option, if there is none.
absl::StatusOr<BenchModel> FindModel(const std::vector<BenchModel>& models, const std::string& name,
                                     const char* option) {
  const auto found = std::find_if(models.begin(), models.end(), [&](const auto& model) { return model.name == name; });
  if (found != models.end()) return *found;
  const std::string known =
      absl::StrJoin(models, ", ", [](std::string* out, const BenchModel& model) { absl::StrAppend(out, model.name); });
  return UsageError(absl::StrCat(option, ": no model is called \"", name, "\"; there are ", known));
}

// Returns the models of --names, in their order; all without it.
absl::StatusOr<std::vector<BenchModel>> ChooseModels(const std::vector<BenchModel>& models,
                                                     const std::vector<std::string>& names) {
  if (names.empty()) return models;
  std::vector<BenchModel> chosen;
  for (const std::string& name : names) {
    EVPOSE_ASSIGN_OR_RETURN(chosen.emplace_back(), FindModel(models, name, "--names"));
  }
  return chosen;
}

absl::Status RunFirstPoses(const ModelsArguments& arguments, FirstPoseBenchOptions options, CliContext& context) {
  if (arguments.watch_s.value_or(0.0) > arguments.duration_s) {
    return UsageError(absl::StrFormat("--watch %g is longer than the recordings, which have --duration %g s",
                                      *arguments.watch_s, arguments.duration_s));
  }
  options.watch_us = std::llround(arguments.watch_s.value_or(std::min(kWatchS, arguments.duration_s)) * 1e6);
  EVPOSE_RETURN_IF_ERROR(AsUsageError(options.Validate()));
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> json, OpenOutput(arguments.out));
  ProgressLine progress(context);
  std::vector<FirstPoseBenchRow> rows;
  PrintFirstPoseHeader(context.out);
  const auto on_row = [&](const FirstPoseBenchRow& row) {
    progress.Clear();
    PrintFirstPoseRow(row, context.out);
    rows.push_back(row);
  };
  const auto on_progress = [&](double ratio, const std::string& text) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  %s", 100.0 * ratio, text));
    return !context.IsInterrupted();
  };
  EVPOSE_RETURN_IF_ERROR(RunFirstPoseBench(options, on_row, on_progress));
  progress.Clear();
  PrintFirstPoseSummary(rows, context.out);
  if (options.explains) PrintStartCauses(rows, context.out);
  return FinishOutput(json, FirstPoseJson(rows, options).dump(2) + "\n");
}

absl::Status RunModels(const ModelsArguments& arguments, CliContext& context) {
  ModelBenchOptions options = arguments.options;
  options.duration_us = std::llround(arguments.duration_s * 1e6);
  options.load_model = LoadModelFile;
  EVPOSE_ASSIGN_OR_RETURN(options.scene, ParseModelBenchScene(arguments.scene));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<BenchModel> models, FindAllModels(arguments));
  EVPOSE_ASSIGN_OR_RETURN(options.models, ChooseModels(models, arguments.names));
  EVPOSE_RETURN_IF_ERROR(AsUsageError(options.Validate()));
  if (arguments.is_first_pose) {
    FirstPoseBenchOptions first_pose = arguments.first_pose;
    first_pose.bench = options;
    if (!arguments.shown.empty()) {
      EVPOSE_ASSIGN_OR_RETURN(first_pose.shown, FindModel(models, arguments.shown, "--shown"));
    }
    return RunFirstPoses(arguments, std::move(first_pose), context);
  }
  EVPOSE_ASSIGN_OR_RETURN(std::optional<OutputFile> json, OpenOutput(arguments.out));
  ProgressLine progress(context);
  std::vector<ModelBenchRow> rows;
  PrintModelsHeader(context.out);
  const auto on_row = [&](const ModelBenchRow& row) {
    progress.Clear();
    PrintModelsRow(row, context.out);
    rows.push_back(row);
  };
  const auto on_progress = [&](double ratio, const std::string& text) {
    progress.Show(ratio, absl::StrFormat("%3.0f %%  %s", 100.0 * ratio, text));
    return !context.IsInterrupted();
  };
  EVPOSE_RETURN_IF_ERROR(RunModelBench(options, on_row, on_progress));
  progress.Clear();
  PrintModelsSummary(rows, context.out);
  return FinishOutput(json, ModelsJson(rows, options).dump(2) + "\n");
}

}  // namespace

CommandRunner AddBenchModelsCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<ModelsArguments>();
  app.option_defaults()->group(kInputGroup);
  app.add_option(
         "--models", arguments->directory,
         absl::StrCat("Directory of tests/bench/models/generate.py, or with any model files (", kModelFormats, ")"))
      ->type_name("DIR")
      ->required();
  AddNames(app, "--names", arguments->names, "Run only these models");
  AddOption(app, "--scale", arguments->metres_per_unit,
            "Metres per unit of the files of a directory without models.json: 0.001 for millimetres", AboveZero())
      ->type_name("FACTOR");
  app.option_defaults()->group(kExperimentGroup);
  AddOption(app, "--seeds", arguments->options.num_seeds, "Number of recordings of each model", NumberRange(1, 1000));
  AddOption(app, "--duration", arguments->duration_s, "Length of a recording", NumberRange(0.01, 1800.0))
      ->type_name("SECONDS");
  AddOption(app, "--camera", arguments->options.camera, "Sensor and lens", CLI::IsMember(SimulatedCameraNames()));
  AddOption(app, "--scene", arguments->scene,
            "standard: a background at rest; occluder: also a bar that hides 35 % of the object; moving-background: a "
            "background that moves in the image",
            CLI::IsMember(ModelBenchSceneNames()));
  AddOption(app, "--noise", arguments->options.noise_ratio, "Share of all events that are noise", NumberRange(0.0, 0.9))
      ->type_name("RATIO");
  app.add_option("--recordings", arguments->options.recordings,
                 "Directory where the simulated recordings are kept and used again")
      ->type_name("DIR");
  CLI::Option* const first_pose =
      app.add_flag("--first-pose", arguments->is_first_pose, "Find the first pose without a prior, instead");
  AddOption(app, "--starts", arguments->first_pose.num_starts, "Number of starts in each recording of --first-pose",
            NumberRange(1, 10'000))
      ->needs(first_pose);
  app.add_option("--watch", arguments->watch_s, "Length of the events after a start of --first-pose")
      ->type_name("SECONDS")
      ->check(NumberRange(0.01, 1800.0))
      ->default_str("0.4")
      ->needs(first_pose);
  CLI::Option* const shown =
      app.add_option(
             "--shown", arguments->shown,
             "Search for the objects of --first-pose in the recordings of this model, where they are absent and "
             "every pose is wrong")
          ->type_name("NAME")
          ->needs(first_pose);
  app.add_flag("--explain", arguments->first_pose.explains, "Print why the starts of --first-pose find no right pose")
      ->needs(first_pose)
      ->excludes(shown);
  AddOutputFile(app, "-o,--out", arguments->out, "JSON with all runs; the file appears when it is complete")
      ->group(kOutputGroup);
  app.footer(absl::StrCat(kModelsTableHelp, kFirstPoseTableHelp, kStartCauseHelp,
                          "\nExample:\n"
                          "  evpose simulate --object cube --camera vga --duration 0.01 --out part\n"
                          "  evpose bench models --models part --camera vga --seeds 1 --duration 0.1"));
  return [arguments, &context] { return RunModels(*arguments, context); };
}

}  // namespace evpose::client
