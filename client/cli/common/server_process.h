// SPDX-License-Identifier: Apache-2.0

// An evpose-server as a process of its own, for as long as somebody needs it.
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::client {

// It keeps nothing (its store is memory), listens on a free port of this machine alone, and ends with this process,
// however that ends.
class ServerProcess {
 public:
  // Starts the evpose-server beside this program, else that of the same build, else the one in the PATH, with
  // `arguments` beside its own, and waits until it listens. Errors: NOT_FOUND when there is none, with what to do;
  // UNAVAILABLE when it ends before it listens: what it says of that goes to the standard error.
  static absl::StatusOr<std::unique_ptr<ServerProcess>> Start(const std::vector<std::string>& arguments);
  ~ServerProcess();  // ends it
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
