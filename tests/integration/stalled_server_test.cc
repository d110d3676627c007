// SPDX-License-Identifier: Apache-2.0

// Commands end at an interrupt while the server does not answer.
#include <gtest/gtest.h>

#include <atomic>
#include <sstream>
#include <string>
#include <vector>

#include "client/cli/cli.h"
#include "client/lib/stalled_server_testing.h"
#include "client/view/page_files.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

class StalledServerTest : public CliTest {
 protected:
  // Runs a command that is interrupted when its first call of a session has arrived.
  CliResult RunAndInterrupt(std::vector<std::string> arguments) {
    std::atomic<bool> is_called = false;
    client::StalledServer server([&](const std::string&) { is_called = true; });
    std::ostringstream out, err;
    client::CliContext context{out, err};
    context.is_interrupted = [&] { return is_called.load(); };
    arguments.insert(arguments.end(), {"--server", server.address()});
    const int status = client::RunCli(arguments, context);
    return {status, out.str(), err.str()};
  }
};

TEST_F(StalledServerTest, AnInterruptEndsWatch) {
  const CliResult result = RunAndInterrupt({"watch", "sessions/1", "--out", Path("poses.mcap")});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_TRUE(FilesBeginning("poses").empty());
}

TEST_F(StalledServerTest, AnInterruptEndsView) {
  if (client::EmbeddedPage().empty()) GTEST_SKIP() << "built without the page: node or npm was missing";
  const CliResult result = RunAndInterrupt({"view", "sessions/1"});
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(result.out, "") << "no address";
}

}  // namespace
}  // namespace evpose
