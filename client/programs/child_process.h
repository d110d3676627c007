// SPDX-License-Identifier: Apache-2.0

// Another program of the project that exchanges bytes with this one through its standard input and output.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace evpose::client {

class ChildProcess {
 public:
  // Starts the program at `path`. Errors: INTERNAL if it cannot be started.
  static absl::StatusOr<std::unique_ptr<ChildProcess>> Start(const std::string& path,
                                                             const std::vector<std::string>& arguments);
  // Ends the program if it is still running.
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  // Waits for bytes of its standard output and returns their number; 0 at its end. Errors: UNAVAILABLE.
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer);

  // Writes all bytes to its standard input. Errors: those of Wait() if it has ended, otherwise UNAVAILABLE.
  absl::Status Write(absl::Span<const uint8_t> bytes);

  // Closes the program's standard input and waits until the program ends. Errors: INVALID_ARGUMENT with the last line
  // of its standard error, without its name, if its exit status is not 0; INTERNAL if it crashed. Later calls return
  // the same.
  absl::Status Wait();

  // What it has written to its standard error: at most the last 64 KiB.
  std::string ErrorText() const;

 private:
  ChildProcess(std::string name, pid_t pid, int channel, int errors)
      : name_(std::move(name)), pid_(pid), channel_(channel), errors_(errors) {}

  const std::string name_;
  pid_t pid_;          // -1 after the end
  absl::Status end_;   // result of Wait()
  const int channel_;  // a socket: its standard input and output
  const int errors_;   // a file in memory: its standard error
};

}  // namespace evpose::client
