// SPDX-License-Identifier: Apache-2.0

// States on standard error what a command is waiting for.
#pragma once

#include <optional>
#include <string>
#include <thread>

#include "client/cli/console/cli_context.h"

namespace evpose::client {

// Prints "waiting for <what> ..." if the object still exists after a second. Nothing else may be printed on the
// context's standard error while it exists; the context must outlive it.
class WaitMessage {
 public:
  WaitMessage(const CliContext& context, const std::string& what);

 private:
  std::jthread thread_;
};

// The same for the first bytes of a recording: only standard input and pipes are waited for.
std::optional<WaitMessage> WaitForRecording(const CliContext& context, const std::string& path);

}  // namespace evpose::client
