// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/command.h"

#include <sys/stat.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <system_error>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/cord.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "client/cli/console/wait_message.h"
#include "client/lib/messages/status_details.h"
#include "client/lib/server_address.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"

namespace evpose::client {
namespace {

constexpr char kUsagePayload[] = "evpose/usage";

// Tokens are never read from the command line, which other users of the machine can read.
constexpr char kTokenVariable[] = "EVPOSE_TOKEN";
constexpr size_t kMaxTokenFileBytes = 4096;

// Checks the characters of a token from a file or a variable of this name.
absl::StatusOr<std::string> CheckedToken(absl::string_view text, const std::string& source) {
  const std::string token(absl::StripAsciiWhitespace(text));
  if (IsToken(token)) return token;
  return absl::InvalidArgumentError(
      absl::StrCat(source, ": is not a token. A token has no spaces and no line feeds inside, and a server's list of ",
                   "tokens is not a token; give the token that evpose-server --new-token printed"));
}

absl::StatusOr<std::string> ReadToken(const std::string& path) {
  if (path.empty()) {
    const char* variable = std::getenv(kTokenVariable);
    return variable == nullptr ? std::string() : CheckedToken(variable, kTokenVariable);
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::string contents, ReadFile(path, kMaxTokenFileBytes));
  struct stat info = {};
  if (stat(path.c_str(), &info) == 0 && S_ISREG(info.st_mode) && (info.st_mode & (S_IRWXG | S_IRWXO)) != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat(path, ": other users can read or replace this file: chmod 600 ", path));
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::string token, CheckedToken(contents, path));
  if (token.empty()) return absl::InvalidArgumentError(absl::StrCat(path, ": the file has no token"));
  return token;
}

// The name of the check by which an option of an output file is recognized.
constexpr char kOutputMark[] = "output file";

// Returns a text that is equal for all names of the same file; empty if `path` is no file.
std::string IdentityOfFile(const std::string& path) {
  if (path.empty() || path == "-") return "";
  struct stat info = {};
  if (stat(path.c_str(), &info) == 0) {
    return S_ISREG(info.st_mode) ? absl::StrCat(info.st_dev, " ", info.st_ino) : std::string();
  }
  std::error_code error;
  const std::filesystem::path resolved = std::filesystem::weakly_canonical(path, error);
  return error ? path : resolved.string();
}

std::string CheckAddresses(const std::string& text) {
  for (const absl::string_view address : absl::StrSplit(text, ',')) {
    const absl::Status status = ParseServerAddress(std::string(address)).status();
    if (!status.ok()) return std::string(status.message());
  }
  return "";
}

}  // namespace

absl::Status UsageError(const std::string& message) {
  absl::Status status = absl::InvalidArgumentError(message);
  status.SetPayload(kUsagePayload, absl::Cord());
  return status;
}

absl::Status AsUsageError(const absl::Status& status, const std::string& prefix) {
  return status.ok() ? status : UsageError(absl::StrCat(prefix, status.message()));
}

bool IsUsageError(const absl::Status& status) { return status.GetPayload(kUsagePayload).has_value(); }

CLI::Validator AboveZero() {
  const auto check = [](const std::string& text) -> std::string {
    double number = 0.0;
    if (absl::SimpleAtod(text, &number) && number > 0.0 && std::isfinite(number)) return "";
    return absl::StrCat(text, " is not a number above 0");
  };
  return CLI::Validator(check, "POSITIVE");
}

CLI::Validator NotNegative() {
  const auto check = [](const std::string& text) -> std::string {
    double number = 0.0;
    if (absl::SimpleAtod(text, &number) && number >= 0.0) return "";
    return absl::StrCat(text, " is neither 0 nor a positive number");
  };
  return CLI::Validator(check, "NONNEGATIVE");
}

CLI::Validator NotEmpty() {
  const auto check = [](const std::string& text) -> std::string { return text.empty() ? "the name is empty" : ""; };
  return CLI::Validator(check, "");
}

CLI::Option* AddFile(CLI::App& app, const std::string& name, std::string& path, const std::string& description) {
  return app.add_option(name, path, description)->type_name("FILE")->check(NotEmpty());
}

CLI::Option* AddOutputFile(CLI::App& app, const std::string& name, std::string& path, const std::string& description) {
  const auto check = [](const std::string& text) -> std::string {
    if (text != "-") return "";
    return "the result is not written to standard output: give the name of a file (./- is a file with this name)";
  };
  return AddFile(app, name, path, description)->check(CLI::Validator(check, "", kOutputMark));
}

bool IsOutputFile(CLI::Option& option) {
  try {
    return option.get_validator(kOutputMark) != nullptr;
  } catch (const CLI::OptionNotFound&) {
    return false;
  }
}

absl::Status CheckNothingIsOverwritten(const std::vector<NamedFile>& inputs, const std::vector<NamedFile>& outputs) {
  std::map<std::string, std::string> options;  // by the identity of the file
  for (const NamedFile& input : inputs) options.emplace(IdentityOfFile(input.path), input.option);
  for (const NamedFile& output : outputs) {
    const std::string identity = IdentityOfFile(output.path);
    const auto [other, is_new] = options.emplace(identity, output.option);
    if (is_new || identity.empty()) continue;
    return UsageError(absl::StrCat(other->second, " and ", output.option, " are the same file, ", output.path,
                                   ", which would be overwritten: give ", output.option, " another name"));
  }
  return absl::OkStatus();
}

CLI::Option* AddPicture(CLI::App& app, const std::string& name, std::string& path, const std::string& description) {
  const auto check = [](const std::string& text) -> std::string {
    if (absl::EndsWith(text, ".png")) return "";
    return absl::StrCat(text, ": pictures are written as PNG; the name must end in .png");
  };
  return AddOutputFile(app, name, path, description)->check(check);
}

CLI::Option* AddJson(CLI::App& app, bool& is_json, const std::string& description) {
  return app.add_flag("--json", is_json, description)->group(kOutputGroup);
}

CLI::Option* AddNames(CLI::App& app, const std::string& name, std::vector<std::string>& names,
                      const std::string& description) {
  return app.add_option(name, names, description)->delimiter(',')->type_name("NAME,...");
}

bool IsSessionName(absl::string_view text) { return absl::ConsumePrefix(&text, "sessions/") && !text.empty(); }

void AddSessionName(CLI::App& app, std::string& name) {
  const auto check = [](const std::string& text) {
    return IsSessionName(text)
               ? ""
               : "the name of a session has the form sessions/ID; `evpose sessions list` prints the names";
  };
  app.add_option("session", name, "Name of the session, as evpose sessions list prints it: sessions/ID")
      ->required()
      ->check(check)
      ->group(kInputGroup);
}

absl::Status NameError(const char* kind, const std::string& name, const absl::Status& status) {
  if (!absl::IsNotFound(status)) return status;
  return absl::NotFoundError(
      absl::StrCat(name, " does not exist; `evpose ", kind, " list` prints the ", kind, " that do"));
}

absl::Status SessionError(const std::string& name, const absl::Status& status) {
  return NameError("sessions", name, status);
}

absl::Status ModelError(const std::string& path, const absl::Status& status) {
  const StatusDetails details = GetDetails(status);
  std::string description(status.message());
  if (details.field == "chunk" && !details.field_error.empty()) description = details.field_error;
  if (details.field == "header.size_bytes" && !details.field_error.empty()) {
    description = absl::StrCat("its size ", details.field_error);
  }
  return absl::Status(status.code(), absl::StrCat(path, ": ", description));
}

void ServerArguments::AddTo(CLI::App& app, bool is_required) {
  CLI::Option* const server =
      app.add_option("--server", address,
                     "Address of evpose-server, or comma-separated addresses of several that share a store")
          ->type_name("HOST:PORT")
          ->check(CheckAddresses)
          ->required(is_required);
  const std::vector<CLI::Option*> ways = {
      app.add_flag("--tls", tls.is_on,
                   "Encrypt, and verify the server's certificate with the authorities that this system trusts"),
      AddFile(app, "--tls-ca", tls.ca_file,
              "Encrypt, and verify the server's certificate with these authorities alone (PEM)"),
      AddFile(app, "--tls-cert", tls.certificate_file,
              "Encrypt, and present this certificate (PEM) to a server that requires one"),
      AddFile(app, "--tls-key", tls.key_file, "Private key of --tls-cert (PEM)"),
      AddFile(app, "--token-file", token_file,
              "File with the token that evpose-server --new-token printed; only its owner may have access (chmod 600). "
              "It is read again before every call. Default: the variable EVPOSE_TOKEN"),
      AddOption(app, "--connect-timeout", connect_timeout_s, "Longest wait for the first response of a server",
                NumberRange(0.001, 86400.0))
          ->type_name("SECONDS")};
  server->group(kConnectionGroup);
  for (CLI::Option* const way : ways) {
    way->group(kConnectionGroup);
    // An option for the connection without --server is an error: the server inside the process would ignore it.
    if (!is_required) way->needs(server);
  }
}

absl::StatusOr<ClientOptions> ServerArguments::Options(const CliContext& context) const {
  ClientOptions options;
  options.tls = tls;
  options.tls.is_on = tls.is_on || !tls.ca_file.empty() || !tls.certificate_file.empty();
  if (tls.certificate_file.empty() != tls.key_file.empty()) {
    return UsageError("--tls-cert and --tls-key belong together: give both");
  }
  EVPOSE_ASSIGN_OR_RETURN(options.token, ReadToken(token_file));
  // Only a regular file can be read again, unlike a pipe.
  if (std::error_code error; std::filesystem::is_regular_file(token_file, error)) {
    options.renew_token = [path = token_file] { return ReadToken(path); };
  }
  options.connect_timeout = absl::Seconds(connect_timeout_s);
  options.is_cancelled = context.is_interrupted;
  return options;
}

absl::StatusOr<std::unique_ptr<Client>> ServerArguments::Connect(const CliContext& context) const {
  EVPOSE_ASSIGN_OR_RETURN(const ClientOptions options, Options(context));
  const WaitMessage wait(context, absl::StrCat("a server at ", address));
  return Client::Connect(address, options);
}

absl::Status PrintResult(CliContext& context, bool is_json, const Json& json,
                         const std::function<void(std::ostream&)>& print, int indent) {
  if (is_json) {
    context.out << json.dump(indent, ' ', false, Json::error_handler_t::replace) << "\n";
  } else {
    print(context.out);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::optional<OutputFile>> OpenOutput(const std::string& path) {
  if (path.empty()) return std::nullopt;
  return OutputFile::Create(path);
}

absl::Status FinishOutput(std::optional<OutputFile>& file, std::string_view rest) {
  if (!file) return absl::OkStatus();
  EVPOSE_RETURN_IF_ERROR(file->Append(rest));
  return file->Commit();
}

Json MillisecondsJson(const std::optional<absl::Duration>& duration) {
  return duration ? Json(absl::ToDoubleMilliseconds(*duration)) : Json(nullptr);
}

Json SymmetryJson(const std::optional<ContinuousSymmetry>& symmetry) {
  if (!symmetry) return nullptr;
  const auto vector = [](const Eigen::Vector3d& v) { return Json::array({v.x(), v.y(), v.z()}); };
  if (symmetry->kind == ContinuousSymmetry::Kind::kSphere) {
    return {{"kind", "SPHERE"}, {"centre_m", vector(symmetry->centre_m)}};
  }
  return {{"kind", "AXIS"},
          {"centre_m", vector(symmetry->centre_m)},
          {"axis", vector(symmetry->axis)},
          {"is_flippable", symmetry->is_flippable}};
}

Json ObjectJson(const ObjectHealth& object) {
  const std::optional<Loss>& loss = object.latest_loss;
  const SearchCounts& searches = object.searches;
  return {{"object_id", object.object_id},
          {"state", std::string(TrackStateName(object.state))},
          {"losses", object.losses},
          {"lost_at_us", loss ? Json(loss->t_us) : Json(nullptr)},
          {"loss_cause", loss ? Json(std::string(LossCauseName(loss->cause))) : Json(nullptr)},
          {"initialization", std::string(InitializationStatusName(object.initialization))},
          {"initialization_attempts", object.initialization_attempts},
          {"searches",
           {{"no_signal", searches.no_signal},
            {"too_small", searches.too_small},
            {"too_few_lines", searches.too_few_lines},
            {"not_enough_motion", searches.not_enough_motion},
            {"no_pose_fits", searches.no_pose_fits},
            {"poses_found", searches.poses_found}}},
          {"followed_poses", object.followed_poses},
          {"detail", object.detail}};
}

Json ProcessingJson(const ProcessingHealth& processing) {
  return {{"cpu_s_per_s", processing.cpu_s_per_s},
          {"max_cpu_s_per_s", processing.max_cpu_s_per_s},
          {"falls_behind", processing.falls_behind},
          {"tenant_cpu_s_per_s", processing.tenant_cpu_s_per_s},
          {"max_tenant_cpu_s_per_s", processing.max_tenant_cpu_s_per_s}};
}

std::string DescribeProcessing(const ProcessingHealth& processing) {
  const auto cores = [](double used, double limit) {
    return limit > 0.0 ? absl::StrFormat("%.2f of %.2f cores", used, limit) : absl::StrFormat("%.2f cores", used);
  };
  return absl::StrCat(cores(processing.cpu_s_per_s, processing.max_cpu_s_per_s), ", tenant ",
                      cores(processing.tenant_cpu_s_per_s, processing.max_tenant_cpu_s_per_s));
}

std::string DescribeState(const ObjectHealth& object) {
  std::string text(TrackStateName(object.state));
  if (object.state != TrackState::kInitializing && object.state != TrackState::kLost) return text;
  return absl::StrCat(text, " (", std::string(InitializationStatusName(object.initialization)), ")");
}

absl::Status CheckCameraMatches(const CameraModel& camera, const std::string& camera_path,
                                const RecordingHeader& header, const std::string& recording_path) {
  const SensorGeometry& sensor = header.geometry;
  if (!header.geometry_is_known) return absl::OkStatus();
  if (sensor.width_px == camera.width_px && sensor.height_px == camera.height_px) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(camera_path, " is of ", camera.width_px, "x", camera.height_px,
                                                 " pixels, but ", recording_path, " of ", sensor.width_px, "x",
                                                 sensor.height_px, ": the camera file of that sensor is needed"));
}

}  // namespace evpose::client
