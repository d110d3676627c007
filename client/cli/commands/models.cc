// SPDX-License-Identifier: Apache-2.0

// evpose models: lists, uploads, describes and deletes the models of a server.
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/time/time.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/console/wait_message.h"
#include "client/model_intake/model_intake.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

struct ModelArguments {
  ServerArguments server;
  std::string name;
  std::string file;
  ModelReadingArguments reading;
  bool is_json = false;
};

const char* SurfaceText(ModelSurface surface) { return surface == ModelSurface::kSmooth ? "smooth" : "as-is"; }

std::string SymmetryText(const ModelInfo& model) {
  if (!model.continuous_symmetry) {
    return model.num_symmetries == 1 ? "no symmetry" : Counted(model.num_symmetries, "symmetry", "symmetries");
  }
  const ContinuousSymmetry& symmetry = *model.continuous_symmetry;
  if (symmetry.kind == ContinuousSymmetry::Kind::kSphere) return "symmetric about a centre";
  return absl::StrFormat("symmetric about the axis (%.3f, %.3f, %.3f)%s", symmetry.axis.x(), symmetry.axis.y(),
                         symmetry.axis.z(), symmetry.is_flippable ? " and turned over" : "");
}

Json ModelJson(const ModelInfo& model) {
  return {{"name", model.name},
          {"file_name", model.file_name},
          {"size_bytes", model.size_bytes},
          {"faces", model.num_faces},
          {"lines", model.num_lines},
          {"curves", model.num_curves},
          {"regions", model.num_regions},
          {"symmetries", model.num_symmetries},
          {"continuous_symmetry", SymmetryJson(model.continuous_symmetry)},
          {"diameter_m", model.diameter_m},
          {"metres_per_unit", model.metres_per_unit},
          {"crease_angle_deg", model.crease_angle_deg},
          {"surface", SurfaceText(model.surface)},
          {"sha256", model.sha256_hex},
          {"create_time", absl::FormatTime(model.create_time, absl::UTCTimeZone())},
          {"notices", model.notices}};
}

void PrintModel(const ModelInfo& model, std::ostream& out) {
  out << model.name
      << absl::StrFormat("  %s  %s  %s  %s  diameter %s  %s\n", Counted(model.num_lines, "line"),
                         Counted(model.num_curves, "curve"), Counted(model.num_faces, "face"), SymmetryText(model),
                         FormatLength(model.diameter_m), model.file_name.empty() ? "-" : model.file_name);
}

// The results of the preparation.
void PrintDetails(const ModelInfo& model, std::ostream& out) {
  out << absl::StrFormat("file         %s, %s\n", model.file_name.empty() ? "without a name" : model.file_name,
                         Counted(model.size_bytes, "byte"));
  out << absl::StrFormat("reading      %g m per unit, crease angle %g degrees, surface %s\n", model.metres_per_unit,
                         model.crease_angle_deg, SurfaceText(model.surface));
  out << absl::StrFormat("mesh         %s, diameter %s\n", Counted(model.num_faces, "face"),
                         FormatLength(model.diameter_m));
  if (model.num_regions > 0) out << absl::StrFormat("regions      %d\n", model.num_regions);
  out << absl::StrFormat("edges        %s, %s\n", Counted(model.num_lines, "straight line"),
                         Counted(model.num_curves, "curve"));
  out << "symmetry     " << SymmetryText(model) << "\n";
}

absl::Status Print(const ModelInfo& model, bool is_json, CliContext& context) {
  return PrintResult(context, is_json, ModelJson(model), [&model](std::ostream& out) {
    out << model.name << "\n";
    PrintDetails(model, out);
    for (const std::string& notice : model.notices) out << "notice: " << notice << "\n";
  });
}

absl::Status RunList(const ModelArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  EVPOSE_ASSIGN_OR_RETURN(
      const std::vector<ModelInfo> models,
      WaitFor(context, "the models of " + arguments.server.address, [&] { return client->ListModels(); }));
  return PrintList(context, arguments.is_json, models, ModelJson, PrintModel);
}

absl::Status RunUpload(const ModelArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const ModelUpload upload, arguments.reading.ReadForUpload(context, arguments.file));
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  EVPOSE_ASSIGN_OR_RETURN(const ModelInfo model, UploadModel(context, *client, arguments.file, upload));
  return Print(model, arguments.is_json, context);
}

absl::Status RunGet(const ModelArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  const absl::StatusOr<ModelInfo> model =
      WaitFor(context, "the properties of " + arguments.name, [&] { return client->GetModel(arguments.name); });
  EVPOSE_RETURN_IF_ERROR(NameError("models", arguments.name, model.status()));
  return Print(*model, arguments.is_json, context);
}

absl::Status RunDelete(const ModelArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  return NameError("models", arguments.name, WaitFor(context, "the server to delete " + arguments.name, [&] {
                     return client->DeleteModel(arguments.name);
                   }));
}

std::string Example(const std::string& command) {
  std::string text =
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose models upload cube/model.obj --server 127.0.0.1:50051";
  if (command == "list") absl::StrAppend(&text, "\n  evpose models list --server 127.0.0.1:50051");
  if (command == "get" || command == "delete") {
    absl::StrAppend(&text,
                    "\n  model=$(evpose models list --server 127.0.0.1:50051 | sed 's/ .*//;q')"
                    "\n  evpose models ",
                    command, " \"$model\" --server 127.0.0.1:50051");
  }
  return text;
}

}  // namespace

void AddModelsCommands(CLI::App& app, CliContext& context, CommandRunners& runners) {
  const auto add = [&](const char* name, const char* description, auto run, auto add_options) {
    CLI::App* command = app.add_subcommand(name, description);
    auto arguments = std::make_shared<ModelArguments>();
    add_options(*command, *arguments);
    command->footer(Example(name));
    arguments->server.AddTo(*command, true);
    AddJson(*command, arguments->is_json);
    runners.emplace_back(command, [arguments, run, &context] { return run(*arguments, context); });
  };
  const auto add_name = [](CLI::App& command, ModelArguments& arguments) {
    command.add_option("model", arguments.name, "Name of the model, as evpose models list prints it: models/ID")
        ->required()
        ->group(kInputGroup);
  };
  CommandRunner inspect = AddInspectCommand(app, context);
  add("list", "List the models of a server, one on each line: name, edges, size and file", RunList,
      [](CLI::App&, ModelArguments&) {});
  add("upload", "Upload a model; identical files and options have the same name", RunUpload,
      [](CLI::App& command, ModelArguments& arguments) {
        AddFile(command, "file", arguments.file, absl::StrCat("Model file: ", kModelFormats))
            ->required()
            ->group(kInputGroup);
        arguments.reading.AddTo(command);
      });
  add("get", "Print the properties of one model", RunGet, add_name);
  add("delete", "Delete a model that no session uses. A model that does not exist is an error", RunDelete, add_name);
  runners.emplace_back(app.get_subcommand("inspect"), std::move(inspect));
  app.footer(Example("upload"));
}

}  // namespace evpose::client
