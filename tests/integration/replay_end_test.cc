// SPDX-License-Identifier: Apache-2.0

// The pose files and the exit status of a replay without a pose, or after an interrupt.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "client/cli/cli.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

class ReplayEndTest : public CliTest {};

TEST_F(ReplayEndTest, WithoutAPoseAnEarlierFileStays) {
  SimulateCube(0.001);
  WriteText("poses.tum", "earlier\n");
  std::vector<std::string> arguments = SearchArguments("poses.tum");
  const CliResult json = Run(arguments);
  EXPECT_EQ(json.status, 1);
  EXPECT_THAT(json.err,
              HasSubstr("no pose was found; the report has the reason; earlier pose files stay as they were"));
  EXPECT_EQ(json.Json()["files"], nlohmann::json::array());
  std::erase(arguments, "--json");
  EXPECT_THAT(Run(arguments).out,
              HasSubstr("poses.tum: not written, because there is no pose for it; the earlier file"));
  EXPECT_EQ(ReadText("poses.tum"), "earlier\n");
  EXPECT_EQ(FilesBeginning("poses.tum").size(), 1u) << "no temporary file";

  EXPECT_EQ(Run(SearchArguments("first.tum")).status, 1);
  EXPECT_TRUE(std::filesystem::exists(Path("first.tum"))) << "without an earlier file, an empty one is written";
}

// Runs a replay that is interrupted after it has asked for an interrupt so many times, as it does before each read.
CliResult RunInterrupted(const std::vector<std::string>& arguments, int asks) {
  std::atomic<int> rest = asks;
  std::ostringstream out, err;
  client::CliContext context{out, err};
  context.is_interrupted = [&rest] { return --rest < 0; };
  CliResult result;
  result.status = client::RunCli(arguments, context);
  result.out = out.str();
  result.err = err.str();
  return result;
}

TEST_F(ReplayEndTest, AnInterruptBeforeTheEndIsAFailureWithThePosesSoFar) {
  SimulateCube(0.1);
  const CliResult all = Run(ReplayArguments("all.csv"));
  ASSERT_EQ(all.status, 0) << all.err;
  const CliResult result = RunInterrupted(ReplayArguments("poses.csv"), 3);
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("recording.raw: interrupted before its end: there are "));
  EXPECT_EQ(result.Json()["interrupted"], true);
  EXPECT_LT(result.Json()["poses"], all.Json()["poses"]);
  std::string poses = ReadText("poses.csv");
  ASSERT_GT(std::count(poses.begin(), poses.end(), '\n'), 10);
  poses.pop_back();
  poses.erase(poses.rfind('\n'));  // the last pose is that of a window that the interrupt has cut
  EXPECT_EQ(ReadText("all.csv").rfind(poses, 0), 0u) << "the poses so far are the first ones";

  const CliResult followed = RunInterrupted(ReplayArguments("poses.csv", {"--follow"}), 3);
  EXPECT_EQ(followed.status, 0) << followed.err;
  EXPECT_EQ(followed.Json()["interrupted"], true);
}

}  // namespace
}  // namespace evpose
