// SPDX-License-Identifier: Apache-2.0

// Commands that wait state for what, and end at an interrupt while the server does not answer.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <future>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "client/cli/cli.h"
#include "client/lib/stalled_server_testing.h"
#include "client/view/page_files.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

struct Wait {
  std::vector<std::string> arguments;
  std::string text;  // of the line after a second
};

// Runs all commands at the same time, with `run`, and expects their lines.
void ExpectLines(const std::vector<Wait>& waits, const std::function<std::string(const Wait&)>& run) {
  std::vector<std::future<std::string>> printed;
  for (const Wait& wait : waits) printed.push_back(std::async(std::launch::async, run, std::cref(wait)));
  for (size_t i = 0; i < waits.size(); ++i) {
    EXPECT_THAT(printed[i].get(), ::testing::HasSubstr(waits[i].text)) << ::testing::PrintToString(waits[i].arguments);
  }
}

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

TEST_F(StalledServerTest, ACommandSaysForWhichAnswerItWaits) {
  std::vector<Wait> waits = {
      {{"sessions", "list"}, "waiting for the sessions of ADDRESS ...\n"},
      {{"sessions", "get", "sessions/1"}, "waiting for the state of sessions/1 ...\n"},
      {{"sessions", "delete", "sessions/1"}, "waiting for the state of sessions/1 ...\n"},
      {{"sessions", "drain"}, "waiting for the answer of ADDRESS ...\n"},
      {{"models", "list"}, "waiting for the models of ADDRESS ...\n"},
      {{"models", "get", "models/1"}, "waiting for the properties of models/1 ...\n"},
      {{"models", "delete", "models/1"}, "waiting for the server to delete models/1 ...\n"},
      {{"server", "info"}, "waiting for the answer of ADDRESS ...\n"},
      {{"server", "log-level", "info"}, "waiting for the answer of ADDRESS ...\n"},
      {{"watch", "sessions/1"}, "waiting for the state of sessions/1 ...\n"},
      {{"watch", "sessions/1", "--health"}, "waiting for the health of sessions/1 ...\n"},
  };
  if (!client::EmbeddedPage().empty()) {
    waits.push_back({{"view", "sessions/1"}, "waiting for the state of sessions/1 ...\n"});
  }
  ExpectLines(waits, [](const Wait& wait) {
    client::StalledServer server([](const std::string&) {});
    std::vector<std::string> arguments = wait.arguments;
    arguments.insert(arguments.end(), {"--server", server.address()});
    const std::string text = absl::StrReplaceAll(wait.text, {{"ADDRESS", server.address()}});
    const std::string printed = RunWatched(
                                    arguments, text, [&server] { server.Stop(); }, true)
                                    .err;
    return absl::StrReplaceAll(printed, {{server.address(), "ADDRESS"}});
  });
}

using LongWorkTest = CliTest;

TEST_F(LongWorkTest, ACommandSaysThatItReadsAModel) {
  SimulateCube(0.02);
  // A converter that takes until a file exists, for a minute at most.
  WriteText("evpose-convert-step",
            "#!/bin/sh\n"
            "tries=0\n"
            "until test -e \"$1.read\" || test $((tries += 1)) -gt 6000; do sleep 0.01; done\n"
            "exit 1\n");
  ASSERT_EQ(chmod(Path("evpose-convert-step").c_str(), 0700), 0);
  ASSERT_EQ(setenv("PATH", absl::StrCat(directory_.string(), ":", std::getenv("PATH")).c_str(), 1), 0);
  const std::string recording = Path("cube/recording.raw"), camera = Path("cube/camera.yaml");
  const std::string truth = Path("cube/truth.tum");
  std::vector<Wait> waits = {
      {{"models", "inspect", "MODEL"}, "inspecting MODEL ...\n"},
      {{"models", "upload", "MODEL", "--server", "127.0.0.1:1"}, "reading MODEL ...\n"},
      {{"evaluate", "--truth", truth, "--estimate", truth, "--model", "MODEL", "--camera", camera},
       "comparing with " + truth + " ...\n"},
      {{"simulate", "--model", "MODEL", "--out", Path("simulated")}, "reading MODEL ...\n"},
      {{"replay", recording, "--model", "MODEL", "--camera", camera}, "reading MODEL ...\n"},
      {{"render", recording, "--poses", truth, "--model", "MODEL", "--camera", camera, "--out", Path("picture.png")},
       "reading MODEL ...\n"},
      {{"doctor", recording, "--model", "MODEL", "--camera", camera}, "reading MODEL ...\n"},
      {{"calibrate", recording, "--truth", truth, "--model", "MODEL", "--camera", camera, "--out",
        Path("profile.yaml")},
       "reading MODEL ...\n"},
  };
  for (size_t i = 0; i < waits.size(); ++i) {
    const std::string model = absl::StrCat("part", i, ".step");
    WriteText(model, "");
    for (std::string& word : waits[i].arguments) absl::StrReplaceAll({{"MODEL", Path(model)}}, &word);
    absl::StrReplaceAll({{"MODEL", Path(model)}}, &waits[i].text);
  }
  ExpectLines(waits, [](const Wait& wait) {
    const auto is_model = [](const std::string& word) { return absl::EndsWith(word, ".step"); };
    const auto model = std::find_if(wait.arguments.begin(), wait.arguments.end(), is_model);
    return RunWatched(wait.arguments, wait.text, [&model] { std::ofstream(*model + ".read"); }).err;
  });
}

}  // namespace
}  // namespace evpose
