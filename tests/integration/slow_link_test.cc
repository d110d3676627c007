// SPDX-License-Identifier: Apache-2.0

// A run states that the connection is slower than its events.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/integration/cli_fixture.h"
#include "tests/integration/cutting_proxy.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class SlowLinkTest : public CliTest {
 protected:
  void SetUp() override {
    CliTest::SetUp();
    SimulateCube(0.3);
    proxy_.SetTarget(server_.server->port());
    proxy_.HoldAfter(30'000);  // within the events
  }

  LocalServer server_ = StartLocalServer();
  CuttingProxy proxy_;
};

TEST_F(SlowLinkTest, AReplayInRealTimeStatesTheBeginningAndTheEndOfItsLag) {
  const CliResult result =
      RunWatched(ReplayArguments("poses.csv", {"--rate", "1", "--server", proxy_.address()}),
                 "slower than real time: the oldest events have waited for ", [this] { proxy_.Release(); });
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.err, HasSubstr("the events keep up with real time again\n"));
  EXPECT_GT(result.Json()["longest_lag_s"], 1.0);
}

TEST_F(SlowLinkTest, WithoutAPaceThereIsNoLag) {
  proxy_.Release();
  const CliResult result = Run(ReplayArguments("poses.csv", {"--server", proxy_.address()}));
  EXPECT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.err, Not(HasSubstr("slower than")));
  EXPECT_EQ(result.Json()["longest_lag_s"], 0.0);
}

}  // namespace
}  // namespace evpose
