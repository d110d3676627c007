// SPDX-License-Identifier: Apache-2.0
#include "client/cli/console/standard_streams.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <cerrno>

namespace evpose::client {
namespace {

// Ends the process with 0 if all conditions hold, or with the number of the first that does not.
[[noreturn]] void RunWithoutStreams() {
  close(STDIN_FILENO);
  close(STDOUT_FILENO);
  OpenStandardStreams();
  const bool conditions[] = {open("/dev/null", O_RDONLY) > STDERR_FILENO, IsStandardOutputClosed(),
                             [] {
                               pollfd input = {STDIN_FILENO, POLLIN, 0};
                               char byte = 0;
                               return poll(&input, 1, -1) == 1 && read(STDIN_FILENO, &byte, 1) < 0 && errno == EBADF;
                             }(),
                             write(STDOUT_FILENO, "x", 1) < 0 && errno == EBADF};
  int number = 0;
  for (const bool holds : conditions) {
    ++number;
    if (!holds) _exit(number);
  }
  _exit(0);
}

TEST(StandardStreamsDeathTest, AClosedStreamIsAnErrorAndNoOtherFile) {
  EXPECT_FALSE(IsStandardOutputClosed());
  EXPECT_EXIT(RunWithoutStreams(), testing::ExitedWithCode(0), "");
}

}  // namespace
}  // namespace evpose::client
