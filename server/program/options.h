// SPDX-License-Identifier: Apache-2.0

// The options of evpose-server on its command line and in its environment: definition, defaults and validation.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/rpc/server.h"

namespace evpose::server {

struct ProgramOptions {
  ServerOptions server;
  std::string port_file;            // empty: none
  std::string metrics_listen;       // HOST:PORT; empty: no HTTP pages
  std::string load_listen;          // HOST:PORT; empty: no such listener
  std::string store_password_file;  // empty: none
  absl::Duration shutdown_notice;   // from a signal until streams are asked to finish
  bool permits_insecure = false;
  std::string new_token;            // tenant for which a token is made; empty: the server is started
  bool divides_store = false;       // the groups of the store get equal parts of it; the server is not started
  bool is_operator = false;         // the new token is an operator's
  std::string log_level = "info";   // a name of ParseLogLevel()
  std::string log_format = "text";  // a name of ParseLogFormat()
};

constexpr int kWrongUsage = 2;  // exit status

// The result of parsing the command line.
struct ParsedOptions {
  ProgramOptions options;
  // The status with which the program ends: 0 after help or version, which are in the buffer of standard output;
  // kWrongUsage after an error, which was printed on standard error. Absent: the program goes on.
  std::optional<int> exit_status;
};

ParsedOptions ParseOptions(int argc, char** argv);

// Calls `use` with the parser of the options, for the manual page and the completion of shells.
void UseParser(const std::function<void(const CLI::App&)>& use);

// Checks the options without opening anything. Returns an error that names the command-line option, or an empty string.
std::string WrongUsage(const ProgramOptions& options);

// Completes server.store from files and the environment: the data directory and the password. Errors: INVALID_ARGUMENT,
// PERMISSION_DENIED and those of ReadFile(), with file and remedy.
absl::Status CompleteStore(ProgramOptions& options);

// Describes the store for the log, without user and password.
std::string StoreForLog(const StoreOptions& options);

}  // namespace evpose::server
