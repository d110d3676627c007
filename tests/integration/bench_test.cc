// SPDX-License-Identifier: Apache-2.0

// Tests the output and the errors of evpose bench, with few trials.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "core/base/output_file.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::vector<std::string> Arguments(const std::vector<std::string>& more) {
  std::vector<std::string> arguments = {"bench", "initialization"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

TEST_F(CliTest, BenchTableHasARowForEachMethodObjectAndClutter) {
  const CliResult result = Run(
      Arguments({"--trials", "3", "--objects", "cube,planar", "--methods", "sqpnp,evpose", "--clutter", "0/0,2/1"}));
  ASSERT_EQ(result.status, 0) << result.err;
  for (const char* row :
       {"\ncube        0/0      sqpnp ", "\ncube        2/1      evpose ", "\nplanar      0/0      evpose "}) {
    EXPECT_THAT(result.out, HasSubstr(row));
  }
  EXPECT_EQ(std::count(result.out.begin(), result.out.end(), '\n'), 9);
}

TEST_F(CliTest, BenchJsonHoldsTheNumbers) {
  const CliResult result =
      Run(Arguments({"--trials", "4", "--seed", "9", "--objects", "cube", "--methods", "sqpnp,softposit", "--json"}));
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_EQ(json["trials"], 4);
  EXPECT_EQ(json["seed"], 9);
  EXPECT_EQ(json["noise_px"], 0.8);
  ASSERT_EQ(json["rows"].size(), 6u);
  const nlohmann::json& row = json["rows"][0];
  EXPECT_EQ(row["object"], "cube");
  EXPECT_EQ(row["method"], "sqpnp");
  EXPECT_EQ(row["spurious"], 0);
  EXPECT_EQ(row["trials"], 4);
  EXPECT_EQ(row["right"], 4);
  EXPECT_EQ(row["success_ratio"], 1.0);
  EXPECT_LT(row["reprojection_mean_right_px"], 2.0);
  EXPECT_EQ(json["rows"][5]["missing"], 2);
}

TEST_F(CliTest, BenchReportsInvalidArguments) {
  const auto fails = [&](const std::vector<std::string>& more) {
    const CliResult result = Run(Arguments(more));
    EXPECT_EQ(result.status, 2) << result.out;
    return result.err;
  };
  EXPECT_THAT(fails({"--methods", "magic"}), HasSubstr("known are: sqpnp, aspnl, ropnl"));
  EXPECT_THAT(fails({"--objects", "teapot"}), HasSubstr("cuboid"));
  EXPECT_THAT(fails({"--clutter", "2-1"}), HasSubstr("as in 2/1"));
  EXPECT_THAT(fails({"--clutter", "2/1x"}), HasSubstr("as in 2/1"));
  EXPECT_THAT(fails({"--clutter", "2/99"}), HasSubstr("num_missing"));
  EXPECT_THAT(fails({"--trials", "0"}), HasSubstr("--trials"));
  EXPECT_EQ(Run({"bench"}).status, 2);
}

TEST_F(CliTest, BenchCertifiesRotations) {
  const std::vector<std::string> few = {"--trials", "6",         "--objects",    "cube",     "--clutter",
                                        "0/0",      "--methods", "sqpnp,evpose", "--certify"};
  const CliResult table = Run(Arguments(few));
  ASSERT_EQ(table.status, 0) << table.err;
  EXPECT_THAT(table.out, HasSubstr("certified: maximum"));
  std::vector<std::string> with_json = few;
  with_json.push_back("--json");
  const CliResult result = Run(Arguments(with_json));
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json rows = result.Json()["rows"];
  EXPECT_FALSE(rows[0].contains("certificates")) << "the correspondences were given";
  const nlohmann::json& counts = rows[1]["certificates"];
  EXPECT_EQ(counts["maximum"].get<int>() + counts["not_maximum"].get<int>() + counts["unknown"].get<int>(), 6);
  EXPECT_GT(counts["median_ms"], 0.0);
  EXPECT_EQ(rows[1]["failed_seeds"].size(), 6u - rows[1]["right"].get<size_t>());
}

TEST_F(CliTest, BenchFromEventsHasARowForEachObject) {
  const std::vector<std::string> few = {
      "--from-events", "--objects", "cube",   "--camera", "vga",       "--starts", "3",
      "--duration",    "0.4",       "--seed", "4",        "--returns", "1"};
  const CliResult table = Run(Arguments(few));
  ASSERT_EQ(table.status, 0) << table.err;
  EXPECT_THAT(table.out, HasSubstr("\ncube        planes         3 "));
  std::vector<std::string> with_json = few;
  with_json.push_back("--json");
  const CliResult result = Run(Arguments(with_json));
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_EQ(json["camera"], "vga");
  EXPECT_EQ(json["detector"], "planes");
  EXPECT_EQ(json["noise_ratio"], 0.05);
  ASSERT_EQ(json["rows"].size(), 1u);
  const nlohmann::json& row = json["rows"][0];
  EXPECT_EQ(row["object"], "cube");
  EXPECT_EQ(row["starts"], 3);
  EXPECT_EQ(row["right"], 3) << row;
  EXPECT_EQ(row["wrong"], 0);
  EXPECT_EQ(row["failures"].size(), 0u);
  EXPECT_EQ(row["longest_wrong_ms"], 0.0);
  ASSERT_EQ(row["returns"].size(), 1u);
  EXPECT_EQ(row["returns"][0]["seed"], 4);
  EXPECT_EQ(row["returns"][0]["was_tracked"], true);
  EXPECT_LE(row["returns"][0]["tracked_us"], 100'000);
}

TEST_F(CliTest, BenchFromEventsWithLsd) {
  const CliResult result = Run(Arguments({"--from-events", "--detector", "lsd", "--objects", "cube", "--camera", "vga",
                                          "--starts", "2", "--duration", "0.4", "--returns", "0", "--json"}));
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_EQ(json["detector"], "lsd");
  ASSERT_EQ(json["rows"].size(), 1u);
  EXPECT_EQ(json["rows"][0]["detector"], "lsd");
  EXPECT_EQ(json["rows"][0]["starts"], 2);
}

TEST_F(CliTest, BenchOptionsBelongToTheirMode) {
  const auto fails = [&](const std::vector<std::string>& more) {
    const CliResult result = Run(Arguments(more));
    EXPECT_EQ(result.status, 2) << result.out;
    return result.err;
  };
  for (const std::string option : {"--starts", "--duration", "--noise", "--speed", "--returns"}) {
    EXPECT_THAT(fails({option, option == "--noise" ? "0.5" : "1"}), HasSubstr("--from-events")) << option;
    EXPECT_THAT(fails({option, "-1", "--from-events"}), HasSubstr(option));
  }
  EXPECT_THAT(fails({"--camera", "vga"}), HasSubstr("--from-events"));
  EXPECT_THAT(fails({"--camera", "mp4", "--from-events"}), HasSubstr("evk4"));
  EXPECT_THAT(fails({"--detector", "lsd"}), HasSubstr("--from-events"));
  EXPECT_THAT(fails({"--detector", "hough", "--from-events"}), HasSubstr("planes"));
  for (const std::string option : {"--trials", "--methods", "--clutter"}) {
    EXPECT_THAT(fails({"--from-events", option, "1"}), HasSubstr(option));
  }
  EXPECT_THAT(fails({"--from-events", "--certify"}), HasSubstr("--certify"));
  EXPECT_THAT(fails({"--from-events", "--all-trials"}), HasSubstr("--all-trials"));
  EXPECT_THAT(fails({"--from-events", "--objects", "teapot"}), HasSubstr("cuboid"));
}

TEST_F(CliTest, BenchHelpListsTheMethods) {
  const CliResult result = Run(Arguments({"--help"}));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("published-bnb"));
  EXPECT_THAT(result.out, HasSubstr("given the correspondences"));
}

std::vector<std::string> SyntheticArguments(const std::vector<std::string>& more) {
  std::vector<std::string> arguments = {"bench", "synthetic"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

TEST_F(CliTest, BenchSyntheticTableAndCsv) {
  const CliResult result = Run(SyntheticArguments(
      {"--trials", "3", "--methods", "mm,mixture", "--sweeps", "noise,outliers", "--csv", Path("table.csv")}));
  ASSERT_EQ(result.status, 0) << result.err;
  // Two lines of header; twelve rows for each of two methods, and the bound for rows with noise.
  EXPECT_EQ(std::count(result.out.begin(), result.out.end(), '\n'), 2 + 12 * 2 + 11);
  for (const char* row : {"\nnoise       0 px  mm ", "\nnoise      10 px  bound ", "\noutliers    50 %  mixture "}) {
    EXPECT_THAT(result.out, HasSubstr(row));
  }
  const std::string csv = ReadText("table.csv");
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 1 + 12 * 2);
  EXPECT_EQ(csv.rfind("sweep,value,method,trials,none,rotation_median_deg,", 0), 0u);
  const std::string row = csv.substr(csv.find("noise,0,mm,3,0,"));
  EXPECT_THAT(row.substr(0, row.find('\n')), HasSubstr(",,,,")) << "without noise there is no bound";
}

TEST_F(CliTest, BenchSyntheticJsonHoldsTheNumbers) {
  const CliResult result = Run(SyntheticArguments(
      {"--trials", "4", "--seed", "9", "--methods", "ls,mixture", "--sweeps", "outliers", "--json"}));
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_EQ(json["trials"], 4);
  EXPECT_EQ(json["seed"], 9);
  ASSERT_EQ(json["rows"].size(), 12u);
  const nlohmann::json& half = json["rows"][11];
  EXPECT_EQ(half["sweep"], "outliers");
  EXPECT_EQ(half["value"], 0.5);
  EXPECT_EQ(half["method"], "mixture");
  EXPECT_LT(half["rotation_to_bound"], 3.0);
  EXPECT_GT(json["rows"][10]["translation_to_bound"], 20.0) << "least squares";
  EXPECT_GT(half["bound"]["rotation_median_deg"], 0.0);
  EXPECT_LT(half["bound"]["rotation_median_deg"], 1.0);
}

TEST_F(CliTest, BenchSyntheticReportsInvalidArguments) {
  const auto fails = [&](const std::vector<std::string>& more, int status) {
    const CliResult result = Run(SyntheticArguments(more));
    EXPECT_EQ(result.status, status) << result.out;
    EXPECT_THAT(result.out, Not(HasSubstr("noise"))) << "before the first trial";
    return result.err;
  };
  EXPECT_THAT(fails({"--methods", "magic"}, 2), AllOf(HasSubstr("evpose bench synthetic: --methods: there is no magic"),
                                                      HasSubstr("known are: mixture, ls")));
  EXPECT_THAT(fails({"--sweeps", "speed"}, 2), HasSubstr("noise, outliers, lines"));
  EXPECT_THAT(fails({"--trials", "0"}, 2), HasSubstr("--trials"));
  EXPECT_THAT(fails({"--csv", Path("missing/table.csv")}, 1), HasSubstr("missing/table.csv"));
  EXPECT_THAT(FilesBeginning("table"), testing::IsEmpty());
}

TEST_F(CliTest, BenchModelsReportsAWatchThatIsLongerThanTheRecordings) {
  SimulateCube(0.001);
  const CliResult result =
      Run({"bench", "models", "--models", Path("cube"), "--first-pose", "--duration", "0.1", "--watch", "0.4"});
  EXPECT_EQ(result.status, 2);
  EXPECT_THAT(result.err, HasSubstr("--watch 0.4 is longer than the recordings, which have --duration 0.1 s"));
}

TEST_F(CliTest, BenchModelsReportsUnusedAndUnknownNames) {
  SimulateCube(0.001);
  const auto fails = [this](const std::vector<std::string>& options) {
    std::vector<std::string> arguments = {"bench", "models", "--models", Path("cube"), "--duration", "0.1"};
    arguments.insert(arguments.end(), options.begin(), options.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2) << result.err;
    return result.err;
  };
  EXPECT_THAT(fails({"--shown", "model.obj"}), HasSubstr("--first-pose"));
  EXPECT_THAT(fails({"--first-pose", "--shown", "ball"}),
              HasSubstr("--shown: no model is called \"ball\"; there are model.obj"));
  EXPECT_THAT(fails({"--names", "ball"}), HasSubstr("--names: no model is called \"ball\"; there are model.obj"));
  EXPECT_THAT(fails({"--scene", "night"}), HasSubstr("--scene"));
}

std::vector<std::string> SpeedArguments(const std::vector<std::string>& more) {
  std::vector<std::string> arguments = {"bench", "speed", "--duration", "0.02", "--repetitions", "1"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

TEST_F(CliTest, BenchSpeedTableAndJsonHoldEveryFormat) {
  const CliResult result = Run(SpeedArguments({"--parts", "decode,track", "--out", Path("speed.json")}));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_EQ(std::count(result.out.begin(), result.out.end(), '\n'), 1 + 2 * 3 + 3);
  const nlohmann::json json = nlohmann::json::parse(ReadFile(Path("speed.json"), 1 << 20).value_or(""));
  ASSERT_EQ(json["rows"].size(), 9u);
  std::vector<std::string> decoded;
  for (const nlohmann::json& row : json["rows"]) {
    EXPECT_GT(row["events"], 0) << row;
    EXPECT_GT(row["seconds"], 0.0) << row;
    EXPECT_EQ(row.contains("memcpy_ratio"), row["part"] == "decode") << row;
    EXPECT_EQ(row.contains("poses"), row["part"] == "track") << row;
    if (row["part"] == "decode") decoded.push_back(row["what"]);
    EXPECT_NEAR(row["real_time_ratio"].get<double>(),
                row["seconds"].get<double>() / row["sensor_seconds"].get<double>(), 1e-9);
  }
  EXPECT_THAT(decoded, ::testing::ElementsAre("EVT3", "EVT2.1", "EVT2", "EVT3", "EVT2.1", "EVT2"));
}

TEST_F(CliTest, BenchSpeedReportsTheCostOfSixteenTimesTheLines) {
  const CliResult result = Run(SpeedArguments({"--parts", "associate,estimate", "--out", Path("speed.json")}));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("16 times the lines cost"));
  const nlohmann::json rows = nlohmann::json::parse(ReadText("speed.json"))["rows"];
  ASSERT_EQ(rows.size(), 3u * 2u * 2u) << "three scenes";
  for (size_t i = 0; i < rows.size(); ++i) {
    const nlohmann::json& row = rows[i];
    const bool is_cut = i % 2 != 0;
    EXPECT_EQ(row["part"], i / 2 % 2 == 0 ? "associate" : "estimate");
    EXPECT_EQ(row["what"], is_cut ? "lines x16" : "lines x1");
    EXPECT_EQ(row["lines_ratio"], is_cut ? 16.0 : 1.0);
    EXPECT_EQ(row["windows"], rows[i - i % 2]["windows"]);
    EXPECT_GT(row["lines_per_window"], is_cut ? 100.0 : 10.0);
    EXPECT_NEAR(row["ns_per_line"].get<double>() * row["lines_per_window"].get<double>() * row["windows"].get<double>(),
                1e9 * row["seconds"].get<double>(), 1.0);
    if (!is_cut) continue;
    EXPECT_NEAR(row["cost_ratio"].get<double>(), row["seconds"].get<double>() / rows[i - 1]["seconds"].get<double>(),
                1e-9);
  }
}

TEST_F(CliTest, BenchSpeedReportsInvalidArguments) {
  const auto fails = [&](const std::vector<std::string>& more, int status) {
    const CliResult result = Run(SpeedArguments(more));
    EXPECT_EQ(result.status, status) << result.out;
    EXPECT_EQ(result.out, "");
    return result.err;
  };
  EXPECT_THAT(fails({"--parts", "magic"}, 2), HasSubstr("known are: decode, "));
  EXPECT_THAT(fails({"--duration", "0.001"}, 2), HasSubstr("--duration"));
  EXPECT_THAT(fails({"--repetitions", "0"}, 2), HasSubstr("--repetitions"));
  EXPECT_THAT(fails({"--out", Path("missing") + "/speed.json"}, 1), HasSubstr("missing"));
}

}  // namespace
}  // namespace evpose
