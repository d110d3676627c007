// SPDX-License-Identifier: Apache-2.0
#include "server/http/load_listener.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/http/http_client_testing.h"

namespace evpose::server {
namespace {

using ::testing::HasSubstr;

TEST(LoadListenerTest, TheWeightIsWhatIsLeft) {
  EXPECT_EQ(AgentLine(0.0), "100%\n");
  EXPECT_EQ(AgentLine(0.25), "75%\n");
  EXPECT_EQ(AgentLine(0.996), "1%\n");
  EXPECT_EQ(AgentLine(1.0), "1%\n") << "0 % would drain the server";
  EXPECT_EQ(AgentLine(3.0), "1%\n");
}

TEST(LoadListenerTest, EachConnectionReceivesTheLineOfItsTime) {
  int calls = 0;  // used by the listener's thread until it ends
  auto listener = LoadListener::Start("127.0.0.1:0", [&calls] { return AgentLine(0.1 * ++calls); });
  ASSERT_TRUE(listener.ok()) << listener.status();
  EXPECT_EQ(HttpConnection((*listener)->port()).ReadAll(), "90%\n");
  EXPECT_EQ(HttpConnection((*listener)->port()).ReadAll(), "80%\n");
  listener->reset();
  EXPECT_EQ(calls, 2);
}

TEST(LoadListenerTest, SilentAndTalkativeConnectionsDelayNoOther) {
  auto listener = LoadListener::Start("127.0.0.1:0", [] { return AgentLine(0.5); });
  ASSERT_TRUE(listener.ok()) << listener.status();
  std::vector<std::unique_ptr<HttpConnection>> silent;
  for (int i = 0; i < 100; ++i) silent.push_back(std::make_unique<HttpConnection>((*listener)->port()));
  silent.front()->Write(std::string(100'000, 'x'));
  EXPECT_EQ(HttpConnection((*listener)->port()).ReadAll(), "50%\n");
}

TEST(LoadListenerTest, ReportsAddressesThatCannotBeUsed) {
  EXPECT_EQ(LoadListener::Start("nonsense", [] { return AgentLine(0.0); }).status().code(),
            absl::StatusCode::kInvalidArgument);
  auto first = LoadListener::Start("127.0.0.1:0", [] { return AgentLine(0.0); });
  ASSERT_TRUE(first.ok());
  const std::string taken = absl::StrCat("127.0.0.1:", (*first)->port());
  const absl::Status status = LoadListener::Start(taken, [] { return AgentLine(0.0); }).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(status.message()), HasSubstr(taken));
}

}  // namespace
}  // namespace evpose::server
