// SPDX-License-Identifier: Apache-2.0

// Tests the output and the files of evpose bench tracking with short recordings, and the NEES of evpose evaluate.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "core/base/output_file.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

std::vector<std::string> Arguments(const std::vector<std::string>& more) {
  std::vector<std::string> arguments = {"bench", "tracking", "--scenarios", "constant-light", "--seeds",
                                        "1",     "--paths",  "2",           "--duration",     "0.1"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

TEST_F(CliTest, BenchTrackingWritesTableAndCsvAndKeepsItsRecordings) {
  const std::vector<std::string> with_files = {
      "--estimators", "mixture,static-mm,oracle", "--csv", Path("tracking.csv"), "--recordings", Path("kept")};
  const CliResult result = Run(Arguments(with_files));
  ASSERT_EQ(result.status, 0) << result.err;
  for (const char* text : {"constant-light: ", "640x480, 2 x 0.1 s", "\n  mixture ", "\n  static-mm ", "\n  oracle ",
                           "worst runs: mixture: seed 1, path ", "  inside  "}) {
    EXPECT_THAT(result.out, HasSubstr(text));
  }
  const std::string csv = ReadFile(Path("tracking.csv"), 1 << 20).value_or("");
  EXPECT_THAT(csv, HasSubstr("scenario,estimator,seed,path,poses,losses,coverage_ratio,"));
  EXPECT_THAT(csv, HasSubstr("\nconstant-light,static-mm,1,2,"));
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 1 + 3 * 2);
  const fs::path kept = fs::path(Path("kept")) / "constant-light-seed1-path2-0.1s";
  ASSERT_TRUE(fs::exists(kept / "recording.raw"));
  const auto made_at = fs::last_write_time(kept / "recording.raw");
  const CliResult again = Run(Arguments(with_files));
  ASSERT_EQ(again.status, 0) << again.err;
  EXPECT_EQ(fs::last_write_time(kept / "recording.raw"), made_at);
}

TEST_F(CliTest, BenchTrackingJsonHoldsSummariesTargetsAndRuns) {
  const CliResult result = Run(Arguments({"--estimators", "mixture,oracle", "--json"}));
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  ASSERT_EQ(json["scenarios"].size(), 1u);
  const nlohmann::json& scenario = json["scenarios"][0];
  EXPECT_EQ(scenario["scenario"], "constant-light");
  EXPECT_GT(scenario["mean_event_rate_hz"], 1e5);
  ASSERT_EQ(scenario["estimators"].size(), 2u);
  const nlohmann::json& mixture = scenario["estimators"][0];
  EXPECT_EQ(mixture["name"], "mixture");
  EXPECT_EQ(mixture["summary"]["runs"], 2);
  EXPECT_EQ(mixture["summary"]["losses"], 0);
  EXPECT_GT(mixture["summary"]["nees_inside_95_ratio"], 0.5);
  EXPECT_LE(mixture["summary"]["nees_inside_95_ratio"], 1.0);
  EXPECT_EQ(mixture["targets"][6]["name"], "inside 95 %");
  EXPECT_EQ(mixture["targets"][6]["low"], 90.0);
  EXPECT_EQ(mixture["targets"][6]["high"], 99.0);
  ASSERT_EQ(mixture["runs"].size(), 2u);
  EXPECT_EQ(mixture["runs"][1]["path"], 2);
  EXPECT_EQ(mixture["targets"][0]["name"], "losses");
  EXPECT_EQ(mixture["targets"][0]["is_met"], true);
  EXPECT_TRUE(scenario["estimators"][1]["targets"].empty());
}

TEST_F(CliTest, BenchTrackingReportsInvalidArguments) {
  const auto fails = [&](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"bench", "tracking"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << result.out;
    return result.err;
  };
  EXPECT_THAT(fails({"--scenarios", "teapot"}), HasSubstr("half-out"));
  EXPECT_THAT(fails({"--estimators", "magic"}), HasSubstr("static-mm"));
  EXPECT_THAT(fails({"--seeds", "0"}), HasSubstr("--seeds"));
  const CliResult list = Run({"bench", "tracking", "--list"});
  EXPECT_EQ(list.status, 0);
  EXPECT_EQ(std::count(list.out.begin(), list.out.end(), '\n'), 17);
}

TEST_F(CliTest, SimulateMakesAScenariosRecording) {
  const CliResult result = Run({"simulate", "--scenario", "half-out", "--duration", "0.01", "--out", Path("half")});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_TRUE(fs::exists(fs::path(Path("half")) / "recording.raw"));
  EXPECT_EQ(Run({"simulate", "--scenario", "half-out", "--object", "book", "--out", Path("book")}).status, 2);
}

// A pose with an error of 3 mm and a standard deviation of 1 mm.
TEST_F(CliTest, EvaluatePrintsTheNeesOfACsv) {
  ASSERT_TRUE(WriteFile(Path("truth.tum"), "1 0 0 1 0 0 0 1\n2 0 0 1 0 0 0 1\n").ok());
  std::string csv = "t_us,tx_m,ty_m,tz_m,qx,qy,qz,qw";
  std::string line = "1500000,0.003,0,1,0,0,0,1";
  const std::vector<std::string> axes = {"tx", "ty", "tz", "rx", "ry", "rz"};
  for (size_t row = 0; row < 6; ++row) {
    for (size_t column = row; column < 6; ++column) {
      csv += ",cov_" + axes[row] + "_" + axes[column];
      line += row == column ? ",1e-6" : ",0";
    }
  }
  ASSERT_TRUE(WriteFile(Path("poses.csv"), csv + "\n" + line + "\n").ok());
  const CliResult result = Run({"evaluate", "--truth", Path("truth.tum"), "--estimate", Path("poses.csv"), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_NEAR(result.Json()["estimates"][0]["nees_median"], 9.0, 1e-9);
  const CliResult table = Run({"evaluate", "--truth", Path("truth.tum"), "--estimate", Path("poses.csv")});
  EXPECT_THAT(table.out, HasSubstr("NEES"));
  EXPECT_THAT(table.out, HasSubstr("9.0-9.0"));
}

}  // namespace
}  // namespace evpose
