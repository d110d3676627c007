// SPDX-License-Identifier: Apache-2.0
#include "client/cli/console/wait_message.h"

#include <filesystem>
#include <stop_token>
#include <system_error>

#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

// Shorter waits are not worth a line.
constexpr absl::Duration kSilence = absl::Seconds(1);

std::jthread PrintLater(const CliContext& context, const std::string& text) {
  return std::jthread([&err = context.err, text](std::stop_token ended) {
    if (!SystemClock().SleepUntil(SystemClock().Now() + kSilence, ended)) return;
    err << absl::StrCat(text, " ...\n") << std::flush;
  });
}

}  // namespace

WaitMessage::WaitMessage(const CliContext& context, const std::string& what)
    : WaitMessage(PrintLater(context, absl::StrCat("waiting for ", what))) {}

WaitMessage WaitMessage::ForWork(const CliContext& context, const std::string& work) {
  return WaitMessage(PrintLater(context, work));
}

std::optional<WaitMessage> WaitForRecording(const CliContext& context, const std::string& path) {
  std::error_code error;
  if (path == "-") return WaitMessage(context, "a recording on standard input");
  if (std::filesystem::is_fifo(path, error))
    return WaitMessage(context, absl::StrCat("a recording in the pipe ", path));
  return std::nullopt;
}

}  // namespace evpose::client
