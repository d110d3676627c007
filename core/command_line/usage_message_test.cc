// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/usage_message.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/base/environment_testing.h"

namespace evpose {
namespace {

// Returns the error of a command with options of all kinds, without the name of the command and the hint at its end.
std::string ErrorOf(const std::string& line) {
  std::string file, out, format;
  double speed = 1.0;
  unsigned count = 0;
  std::vector<double> corner;
  bool is_quick = false, is_slow = false, is_closed = false;
  enum class Side { kLeft, kRight } side = Side::kLeft;
  CLI::App app("A tool", "tool");
  CLI::App& draw = *app.add_subcommand("draw", "Draw a recording");
  draw.add_option("recording", file, "Recording")->type_name("FILE")->required();
  draw.add_option("-o,--out", out, "Picture")->type_name("FILE")->required();
  draw.add_option("--speed", speed, "Factor")->check(CLI::Range(0.5, 1e6));
  draw.add_option("--bytes", count, "Size")->check(CLI::Range(1048576, 16777216));
  draw.add_option("--count", count, "Number")->envname("EVPOSE_TEST_COUNT");
  draw.add_option("--corner", corner, "Place")->expected(2);
  draw.add_option("--closed", is_closed, "Whether it is")->type_name("BOOLEAN");
  draw.add_option("--side", side, "Side")
      ->transform(
          CLI::Transformer(std::vector<std::pair<std::string, Side>>{{"left", Side::kLeft}, {"right", Side::kRight}}));
  draw.add_flag("--slow", is_slow, "Take time");
  CLI::Option* const to =
      draw.add_option("--to", format, "Format")->envname("EVPOSE_TEST_FORMAT")->check(CLI::IsMember({"png", "pdf"}));
  draw.add_flag("--quick", is_quick, "Leave out details")->needs(to)->excludes("--slow");
  try {
    app.parse("draw " + line);
  } catch (const CLI::ParseError& error) {
    std::string message = UsageMessage(draw, error);
    const std::string begin = "tool draw: ", end = "tool draw --help lists the options";
    EXPECT_EQ(message.rfind(begin, 0), 0u) << message;
    EXPECT_EQ(message.rfind(end), message.size() - end.size()) << message;
    return message.substr(begin.size(), message.size() - begin.size() - end.size());
  }
  return "";
}

TEST(UsageMessageTest, MissingArguments) {
  EXPECT_EQ(ErrorOf("--out a.png"), "give RECORDING, which is required; ");
  EXPECT_EQ(ErrorOf("a.raw"), "give --out FILE, which is required; ");
  EXPECT_EQ(ErrorOf("a.raw --out"), "--out has no value: give --out FILE; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --quick"), "--quick requires --to: give --to, too; ");
}

TEST(UsageMessageTest, UnknownOptionsAndExcessArguments) {
  EXPECT_EQ(ErrorOf("a.raw --out a.png --quik"), "there is no option --quik; did you mean --quick? ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --frobnicate=1"), "there is no option --frobnicate; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --frobnicate 1"), "there is no option --frobnicate; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png -z"), "there is no option -z; ");
  // A misspelled option is why the required one is missing.
  EXPECT_EQ(ErrorOf("a.raw --oot a.png"), "there is no option --oot; did you mean --out? ");
  EXPECT_EQ(ErrorOf("a.raw --oot=a.png"), "there is no option --oot; did you mean --out? ");
  EXPECT_EQ(ErrorOf("a.raw b.raw --out a.png"),
            "the argument \"b.raw\" is one too many; a value that contains spaces must be in quotation marks; ");
}

TEST(UsageMessageTest, Values) {
  EXPECT_EQ(ErrorOf("a.raw --out a.png --speed 0.1"), "--speed: \"0.1\" is not a number from 0.5 to 1000000; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --speed fast"), "--speed: \"fast\" is not a number from 0.5 to 1000000; ");
  for (const std::string value : {"1e7", "2097152.5", "1"}) {
    EXPECT_EQ(ErrorOf("a.raw --out a.png --bytes " + value),
              "--bytes: \"" + value + "\" is not a whole number from 1048576 to 16777216; ");
  }
  EXPECT_EQ(ErrorOf("a.raw --out a.png --to gif"), "--to: \"gif\" is none of png, pdf; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --count many"), "--count: \"many\" is not a number; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --count -1"), "--count: \"-1\" is not a whole number of at least 0; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --count 1.5"), "--count: \"1.5\" is not a whole number in its range; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --count 1e12"), "--count: \"1e12\" is not a whole number in its range; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --side top"), "--side: \"top\" is none of left, right; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --closed maybe"), "--closed: \"maybe\" is neither true nor false; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --slow=often"), "--slow has no value, but \"often\" was given; ");
}

TEST(UsageMessageTest, NumbersOfValues) {
  EXPECT_EQ(ErrorOf("a.raw --out a.png --out b.png"), "--out was given 2 times: give it once; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --corner 1"), "--corner needs at least 2 values, but the number given is 1; ");
  EXPECT_EQ(ErrorOf("a.raw --out a.png --slow --quick --to png"),
            "--slow and --quick exclude each other: give one of them; ");
}

TEST(UsageMessageTest, AValueOfAnEnvironmentVariableIsReportedWithTheVariable) {
  {
    const ScopedEnvironmentVariable format("EVPOSE_TEST_FORMAT", "gif");
    EXPECT_EQ(ErrorOf("a.raw --out a.png"),
              "the environment variable EVPOSE_TEST_FORMAT, which stands for --to: \"gif\" is none of png, pdf; ");
    EXPECT_EQ(ErrorOf("a.raw --out a.png --to jpg"), "--to: \"jpg\" is none of png, pdf; ");
    EXPECT_EQ(ErrorOf("a.raw --out a.png --to gif"), "--to: \"gif\" is none of png, pdf; ") << "the same value";
  }
  const ScopedEnvironmentVariable count("EVPOSE_TEST_COUNT", "many");
  EXPECT_EQ(ErrorOf("a.raw --out a.png"),
            "the environment variable EVPOSE_TEST_COUNT, which stands for --count: \"many\" is not a number; ");
}

}  // namespace
}  // namespace evpose
