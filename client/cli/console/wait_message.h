// SPDX-License-Identifier: Apache-2.0

// States on standard error what a command is waiting for, or what it is doing.
#pragma once

#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "client/cli/console/cli_context.h"

namespace evpose::client {

// Prints "waiting for <what> ..." if the object still exists after a second. Nothing else may be printed on the
// context's standard error while it exists; the context must outlive it.
class WaitMessage {
 public:
  WaitMessage(const CliContext& context, const std::string& what);
  // Prints "<work> ..." instead, for work of this process: "reading part.step".
  static WaitMessage ForWork(const CliContext& context, const std::string& work);

 private:
  explicit WaitMessage(std::jthread thread) : thread_(std::move(thread)) {}

  std::jthread thread_;
};

// Returns the result of `call()`, and states what it waits for.
template <typename Call>
auto WaitFor(const CliContext& context, const std::string& what, const Call& call) {
  const WaitMessage message(context, what);
  return call();
}

// Returns a message that states the wait for the first bytes of a recording; nullopt for a path that is neither
// standard input nor a pipe, because files are not waited for.
std::optional<WaitMessage> WaitForRecording(const CliContext& context, const std::string& path);

}  // namespace evpose::client
