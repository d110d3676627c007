// evpose bench: few trials, for what the command says and how it fails.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

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

TEST_F(CliTest, BenchSaysWhatItKnows) {
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

TEST_F(CliTest, BenchHelpListsTheMethods) {
  const CliResult result = Run(Arguments({"--help"}));
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("published-bnb"));
  EXPECT_THAT(result.out, HasSubstr("told which line is which"));
}

}  // namespace
}  // namespace evpose
