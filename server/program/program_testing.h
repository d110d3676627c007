// SPDX-License-Identifier: Apache-2.0

// Runs evpose-server as a process in tests.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "core/base/process_testing.h"

namespace evpose::server {

inline std::string TemporaryPath(const std::string& name) {
  return testing::TempDir() + "/evpose_server_program_test." + std::to_string(getpid()) + "." + name;
}

// The port of HOST:PORT.
inline int PortOf(const std::string& address) {
  int port = 0;
  EXPECT_TRUE(absl::SimpleAtoi(address.substr(address.rfind(':') + 1), &port)) << address;
  return port;
}

// A running evpose-server, or another program with its options; its standard output is a pipe.
class Program : public TestProcess {
 public:
  explicit Program(const std::vector<std::string>& arguments, const char* program = EVPOSE_SERVER)
      : TestProcess(Command(arguments, program)) {}

  // Reads the next line, which begins with `prefix`, for example "listening on ", and returns the rest.
  std::string Announced(const std::string& prefix) {
    const std::string line = ReadLine();
    if (absl::StartsWith(line, prefix)) return line.substr(prefix.size());
    ADD_FAILURE() << "\"" << line << "\" does not begin with \"" << prefix << "\": " << Stderr();
    return "";
  }

 private:
  static std::vector<std::string> Command(const std::vector<std::string>& arguments, const char* program) {
    std::vector<std::string> command = {program};
    // By default the server stores in memory, so that it leaves no files and shares nothing with other tests.
    const bool has_store = std::find(arguments.begin(), arguments.end(), "--store") != arguments.end();
    if (!has_store && std::getenv("EVPOSE_STORE") == nullptr) command.insert(command.end(), {"--store", "memory"});
    command.insert(command.end(), arguments.begin(), arguments.end());
    return command;
  }
};

}  // namespace evpose::server
