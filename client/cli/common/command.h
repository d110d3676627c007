// SPDX-License-Identifier: Apache-2.0

// Types and functions that all commands use.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <ostream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "client/cli/console/cli_context.h"
#include "core/base/length_text.h"
#include "core/base/output_file.h"
#include "core/command_line/help_page.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/recordings/recording_header.h"
#include "evpose/client.h"

namespace evpose::client {

// JSON objects that keep the order in which their keys were set.
using Json = nlohmann::ordered_json;

// null in the place of a number that is not known.
inline Json OrNull(const std::optional<double>& number) { return number ? Json(*number) : Json(nullptr); }

// Runs a command after its arguments have been parsed.
using CommandRunner = std::function<absl::Status()>;
using CommandRunners = std::vector<std::pair<CLI::App*, CommandRunner>>;

// The formats of camera files, for the help of the options that take one.
inline constexpr char kCameraFiles[] =
    "Calibration of the camera: a file of ROS (camera_info or a printed message), Kalibr (FILE#cam1), Metavision, "
    "OpenCV, COLMAP or DV";

// A failure with exit status 2 instead of 1.
absl::Status UsageError(const std::string& message);
// Returns a usage error with the message of `status` after `prefix`; OK for OK.
absl::Status AsUsageError(const absl::Status& status, const std::string& prefix = "");
bool IsUsageError(const absl::Status& status);

// Checks of option values; the error describes an invalid number more briefly than that of CLI11.
CLI::Validator AboveZero();
CLI::Validator NotNegative();  // accepts infinity
CLI::Validator NotEmpty();     // of the name of a file or directory

// Adds an option with a check of its values; --help prints the default value.
template <typename Value>
CLI::Option* AddOption(CLI::App& app, const std::string& name, Value& value, const std::string& description,
                       const CLI::Validator& check) {
  return app.add_option(name, value, description)->check(check)->capture_default_str();
}
// Adds an option for the path of a file.
CLI::Option* AddFile(CLI::App& app, const std::string& name, std::string& path, const std::string& description);
// The same for a file that the command writes: before the command runs, RunCli() checks that it is none of the files
// that other options name. "-" is wrong usage.
CLI::Option* AddOutputFile(CLI::App& app, const std::string& name, std::string& path, const std::string& description);
bool IsOutputFile(CLI::Option& option);
// A file with the name of the option that it was given with.
struct NamedFile {
  std::string option;
  std::string path;
};
// Returns a usage error if one of the outputs is also one of the inputs or another output, under any name (links).
// Devices and pipes, "-" and empty paths are no files.
absl::Status CheckNothingIsOverwritten(const std::vector<NamedFile>& inputs, const std::vector<NamedFile>& outputs);
// Adds an option for a picture that is written as PNG; a name with another extension is wrong usage.
CLI::Option* AddPicture(CLI::App& app, const std::string& name, std::string& path, const std::string& description);
// Adds --json, with which the command prints JSON instead of text.
CLI::Option* AddJson(CLI::App& app, bool& is_json,
                     const std::string& description = "Print one JSON object instead of text");
// Adds an option for a comma-separated list of names.
CLI::Option* AddNames(CLI::App& app, const std::string& name, std::vector<std::string>& names,
                      const std::string& description);

// Returns the error of a model upload with the path of the file in the place of the API's field.
absl::Status ModelError(const std::string& path, const absl::Status& status);

// Whether the text has the form sessions/ID.
bool IsSessionName(absl::string_view text);
// Adds the name of a session, sessions/ID, as a required argument; a text of another form is wrong usage.
void AddSessionName(CLI::App& app, std::string& name);
// Rewords NOT_FOUND for a session of the command line, which the caller does not want to create.
absl::Status SessionError(const std::string& name, const absl::Status& status);
// Does the same as SessionError() for another kind of name. `kind` is the command that lists these names, such as
// "models".
absl::Status NameError(const char* kind, const std::string& name, const absl::Status& status);

// Address of a server, or of several servers that share a store, and the credentials, for the commands that need one.
struct ServerArguments {
  std::string address;
  TlsOptions tls;
  std::string token_file;
  double connect_timeout_s = 10.0;

  void AddTo(CLI::App& app, bool is_required);
  // Errors: wrong usage for a certificate without its key; those of reading the token.
  absl::StatusOr<ClientOptions> Options(const CliContext& context) const;
  // An interrupt ends the wait for a server.
  absl::StatusOr<std::unique_ptr<Client>> Connect(const CliContext& context) const;
};

// Error: INVALID_ARGUMENT naming both files and sizes if the size or the sensor in the header contradicts the size of
// the camera.
absl::Status CheckCameraMatches(const CameraModel& camera, const std::string& camera_path,
                                const RecordingHeader& header, const std::string& recording_path);

// Prints the result of a command: `json` with --json, otherwise text by `print`. Invalid UTF-8 in JSON is replaced.
absl::Status PrintResult(CliContext& context, bool is_json, const Json& json,
                         const std::function<void(std::ostream&)>& print, int indent = 2);

// The same for a list: a JSON array, or the text of each item.
template <typename Item>
absl::Status PrintList(CliContext& context, bool is_json, const std::vector<Item>& items, Json (*to_json)(const Item&),
                       void (*print)(const Item&, std::ostream&)) {
  Json json = Json::array();
  for (const Item& item : items) json.push_back(to_json(item));
  return PrintResult(context, is_json, json, [&](std::ostream& out) {
    for (const Item& item : items) print(item, out);
  });
}

// Opens the output file of an option before the work, so that a path that cannot be written is reported at once;
// nullopt for an empty path. Errors: those of OutputFile::Create().
absl::StatusOr<std::optional<OutputFile>> OpenOutput(const std::string& path);
// Appends the rest of an output and completes it; does nothing for nullopt.
absl::Status FinishOutput(std::optional<OutputFile>& file, std::string_view rest);

// A number of milliseconds; null for nullopt.
Json MillisecondsJson(const std::optional<absl::Duration>& duration);

// Kind, centre and axis of a continuous symmetry, in which the pose is not measured; null for nullopt.
Json SymmetryJson(const std::optional<ContinuousSymmetry>& symmetry);

// All fields of an object's health but the explained ratio.
Json ObjectJson(const ObjectHealth& object);

// All fields of a session's use of processor time.
Json ProcessingJson(const ProcessingHealth& processing);

// "0.43 of 1.00 cores, tenant 0.80 cores": the processor time of a session and its tenant, with their limits if there
// are any.
std::string DescribeProcessing(const ProcessingHealth& processing);

// "TRACKING"; without a pose also the status of the search: "INITIALIZING (TOO_FEW_LINES)".
std::string DescribeState(const ObjectHealth& object);

}  // namespace evpose::client
