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
  EXPECT_EQ(json.Json()["kept_files"], nlohmann::json({Path("poses.tum")}));
  std::erase(arguments, "--json");
  EXPECT_THAT(Run(arguments).out,
              HasSubstr("poses.tum: not written, because there is no pose for it; the earlier file"));
  EXPECT_EQ(ReadText("poses.tum"), "earlier\n");
  EXPECT_EQ(FilesBeginning("poses.tum").size(), 1u) << "no temporary file";

  const CliResult first = Run(SearchArguments("first.tum"));
  EXPECT_EQ(first.status, 1);
  EXPECT_THAT(first.err, ::testing::Not(HasSubstr("earlier"))) << "there is no earlier file";
  EXPECT_EQ(first.Json()["files"], nlohmann::json({Path("first.tum")}));
  EXPECT_TRUE(std::filesystem::exists(Path("first.tum"))) << "without an earlier file, an empty one is written";
}

TEST_F(ReplayEndTest, APoseRateGivesMorePoses) {
  const CliResult simulated =
      Run({"simulate", "--object", "cube", "--duration", "0.05", "--speed", "4", "--out", Path("cube")});
  ASSERT_EQ(simulated.status, 0) << simulated.err;
  const auto num_poses = [this](const std::string& rate) {
    const CliResult result = Run(ReplayArguments("rate.csv", {"--pose-rate", rate, "--json"}));
    EXPECT_EQ(result.status, 0) << result.err;
    return result.Json()["poses"].get<double>();
  };
  const double usual = num_poses("1000");
  EXPECT_GT(usual, 40.0);
  EXPECT_GT(num_poses("4000"), 2.0 * usual);
  const CliResult beyond = Run(ReplayArguments("rate.csv", {"--pose-rate", "10001"}));
  EXPECT_EQ(beyond.status, 2);
  EXPECT_THAT(beyond.err, HasSubstr("--pose-rate"));
}

TEST_F(ReplayEndTest, TheFileOfAnObjectWithoutAPoseStaysBesideThatOfAnotherObject) {
  SimulateCube(0.05);
  for (const char* const extension : {".tum", ".csv", ".jsonl", ".mcap"}) {
    const std::string found = std::string("poses-found") + extension, other = std::string("poses-other") + extension;
    WriteText(found, "earlier\n");
    WriteText(other, "earlier\n");
    const std::vector<std::string> arguments = {"replay",      Path("cube/recording.raw"),
                                                "--camera",    Path("cube/camera.yaml"),
                                                "--object",    "found=" + Path("cube/model.obj"),
                                                "--object",    "other=" + Path("cube/model.obj"),
                                                "--init-pose", "found=" + FirstPose(),
                                                "--out",       Path(std::string("poses-{object}") + extension),
                                                "--json"};
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, HasSubstr("recording.raw: no pose of other was found; the report has the reason"));
    EXPECT_EQ(result.Json()["files"], nlohmann::json({Path(found)}));
    EXPECT_EQ(result.Json()["kept_files"], nlohmann::json({Path(other)}));
    EXPECT_NE(ReadText(found), "earlier\n");
    EXPECT_EQ(ReadText(other), "earlier\n") << extension;
    EXPECT_EQ(FilesBeginning("poses-").size(), 2u) << "no temporary file";
    std::filesystem::remove(Path(found));
    std::filesystem::remove(Path(other));
  }
}

// Runs a replay that is interrupted after it has asked for an interrupt `num_questions` times, as it does before each
// read. This number is the same in each run: without --server, no other thread asks.
CliResult RunInterrupted(const std::vector<std::string>& arguments, int num_questions) {
  std::atomic<int> rest = num_questions;
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
  EXPECT_THAT(result.err, HasSubstr("recording.raw: interrupted before its end: "));
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

TEST_F(ReplayEndTest, AnInterruptThatEndsAFollowedRecordingWithoutAPoseIsAFailure) {
  SimulateCube(0.001);
  const CliResult result = RunInterrupted(SearchArguments("poses.csv", {"--follow"}), 3);
  EXPECT_EQ(result.status, 1);
  EXPECT_EQ(result.Json()["interrupted"], true);
  EXPECT_THAT(result.err, HasSubstr("no pose was found; the report has the reason"));
}

TEST_F(ReplayEndTest, AnInterruptAfterTheEndOfTheRecordingIsNoFailure) {
  SimulateCube(0.02);
  const nlohmann::json events = Run(ReplayArguments("poses.csv")).Json()["events"];
  int num_complete_failures = 0;
  for (int num_questions = 0;; ++num_questions) {
    const CliResult result = RunInterrupted(ReplayArguments("poses.csv"), num_questions);
    const bool is_complete = !result.out.empty() && result.Json()["events"] == events;
    num_complete_failures += result.status == 1 && is_complete;
    if (result.status == 0) break;
  }
  // The question before the read that finds the end comes before the end is known; none is asked between the two.
  EXPECT_EQ(num_complete_failures, 1);
}

}  // namespace
}  // namespace evpose
