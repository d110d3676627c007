// SPDX-License-Identifier: Apache-2.0

// What evpose-server is told on its command line and in its environment: definition, defaults and validation.
#pragma once

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
  std::string metrics_listen;       // HOST:PORT; empty: nowhere
  std::string store_password_file;  // empty: none
  absl::Duration shutdown_notice;   // from a signal until streams are told
  bool insecure = false;
  std::string new_token;            // the tenant that a token is to be made for; empty: the server is to serve
  bool is_operator = false;         // of new_token
  std::string log_level = "info";   // of ParseLogLevel
  std::string log_format = "text";  // of ParseLogFormat
};

// What is left to do when the command line has been read.
struct ParsedOptions {
  ProgramOptions options;
  // Help, version or what is wrong has been printed, on standard output or standard error.
  bool is_answered = false;
  bool is_wrong = false;
};

ParsedOptions ParseOptions(int argc, char** argv);

// What is wrong before anything is opened, in the words of the command line; empty: nothing.
std::string WrongUsage(const ProgramOptions& options);

// Fills server.store in from files and the environment: where the store is, and with which password. Errors:
// INVALID_ARGUMENT, PERMISSION_DENIED and those of ReadFile, with the file and what to do.
absl::Status CompleteStore(ProgramOptions& options);

// The store in a few words. Passwords in an address are for nobody's eyes.
std::string StoreForLog(const StoreOptions& options);

}  // namespace evpose::server
