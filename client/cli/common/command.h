// SPDX-License-Identifier: Apache-2.0

// Types and functions that all commands use.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/common/cli_context.h"
#include "client/lib/client.h"
#include "core/events/event.h"
#include "core/events/recording_header.h"
#include "core/geometry/camera.h"

namespace evpose::client {

// The keys in the order in which they were set.
using Json = nlohmann::ordered_json;

// How a command runs once its arguments are parsed.
using CommandRunner = std::function<absl::Status()>;
using CommandRunners = std::vector<std::pair<CLI::App*, CommandRunner>>;

// Exit status 2 instead of 1.
absl::Status UsageError(const std::string& message);
bool IsUsageError(const absl::Status& status);

// For CLI::Option::check(): what is wrong with the number, in fewer digits than CLI11's own, or nothing.
std::string CheckAboveZero(const std::string& text);
std::string CheckNotNegative(const std::string& text);  // inf is none

// The status of a model that a server did not take, in the words of who has the file instead of those of the API.
absl::Status ModelError(const std::string& path, const absl::Status& status);

// In --help: the options for the time without a server.
inline constexpr char kAwayGroup[] = "While the server is away";

// Where the server is, or several that share a store are, and how to reach it, for the commands that need one.
struct ServerArguments {
  std::string address;
  TlsOptions tls;
  std::string token_file;
  double connect_timeout_s = 10.0;

  void AddTo(CLI::App& app, bool is_required);
  // An interrupt ends the wait for a server.
  absl::StatusOr<std::unique_ptr<Client>> Connect(const CliContext& context) const;
};

// INVALID_ARGUMENT naming both files and sizes when the recording says its size or its sensor and the camera has
// another size.
absl::Status CheckCameraMatches(const CameraModel& camera, const std::string& camera_path,
                                const RecordingHeader& header, const std::string& recording_path);

// "TRACKING"; while there is no pose with what the search for it says: "INITIALIZING (TOO_FEW_LINES)".
std::string DescribeState(const ObjectHealth& object);

}  // namespace evpose::client
