// SPDX-License-Identifier: Apache-2.0

// Runs evpose-server as a child process.
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::client {

// The server stores its sessions in memory, listens on a free port of the loopback interface, and ends with this
// process, however that ends.
class ServerProcess {
 public:
  // Starts the evpose-server in the directory of this program, otherwise that of the same build, otherwise the one in
  // PATH, with `arguments` in addition to its own, and waits until it listens. Errors: NOT_FOUND, with advice, if there
  // is none; UNAVAILABLE if it ends before it listens: its message is on standard error.
  static absl::StatusOr<std::unique_ptr<ServerProcess>> Start(const std::vector<std::string>& arguments);
  ~ServerProcess();  // ends the process
  ServerProcess(const ServerProcess&) = delete;
  ServerProcess& operator=(const ServerProcess&) = delete;

  const std::string& address() const { return address_; }  // HOST:PORT
  pid_t pid() const { return pid_; }

 private:
  ServerProcess(pid_t pid, int output) : pid_(pid), output_(output) {}

  const pid_t pid_;
  const int output_;  // its standard output
  std::string address_;
};

}  // namespace evpose::client
