// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/help.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <stdexcept>

#include "absl/strings/str_split.h"
#include "core/base/environment_testing.h"

namespace evpose {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

// A program with a command that has options of all kinds.
class HelpTest : public ::testing::Test {
 protected:
  HelpTest() {
    draw_.add_option("file", file_, "Recording")->type_name("FILE")->required();
    draw_.add_option("--speed", speed_, "Factor on the speed")
        ->check(CLI::Range(0.5, 1e6))
        ->group(kResearchGroup)
        ->capture_default_str();
    draw_.add_option("-o,--out", out_, "Picture that is written")->type_name("FILE")->group(kOutputGroup)->required();
    CLI::Option* const to = draw_.add_option("--to", format_, "Format of the picture")
                                ->check(CLI::IsMember({"png", "pdf"}))
                                ->group(kOutputGroup);
    draw_.add_flag("--quick", is_quick_, "Leave out details")->group(kOutputGroup)->needs(to);
    draw_.add_option("--hidden", speed_, "No help")->group("");
    draw_.footer(
        "A long paragraph in the source,\nof two lines.\n\n"
        "Columns:\n  first   what it is\n          and more\n  second  another\n\n"
        "Exit status:\n  0  All\n  1  Nothing was drawn\n\n"
        "Example:\n  tool draw a.raw --out a.png \\\n    --quick\nthen\n  tool draw b.raw --out b.png");
    UseHelp(app_);
  }

  std::string file_, out_, format_;
  double speed_ = 1.0;
  bool is_quick_ = false;
  CLI::App app_{"A tool", "tool"};
  CLI::App& draw_ = *app_.add_subcommand("draw", "Draw a recording");
};

TEST_F(HelpTest, HasGroupsInOrderAndFactsOfOptions) {
  EXPECT_EQ(FormatHelp(DescribeCommand(draw_), 60), R"(Draw a recording

Usage: tool draw FILE --out FILE [OPTION]...

Outputs:
  -o, --out FILE          Picture that is written [required]
  --to NAME               Format of the picture [values:
                          png, pdf]
  --quick                 Leave out details [with: --to]

Options:
  FILE                    Recording [required]

General:
  -h, --help              Print this help

Research:
  --speed NUMBER          Factor on the speed [default: 1]
                          [range: 0.5 to 1000000]

A long paragraph in the source, of two lines.

Columns:
  first   what it is and more
  second  another

Exit status:
  0  All
  1  Nothing was drawn

Example:
  tool draw a.raw --out a.png --quick
then
  tool draw b.raw --out b.png
)");
}

TEST_F(HelpTest, AFooterCanHaveTheUsageOfSeveralForms) {
  draw_.footer(
      "Usage:\n  FILE --out FILE (--to NAME | --size N)\n  --list\n\nA paragraph.\n\nExample:\n  tool draw a.raw --out "
      "a.png");
  EXPECT_THAT(FormatHelp(DescribeCommand(draw_), 80),
              HasSubstr("\nUsage: tool draw FILE --out FILE (--to NAME | --size N) [OPTION]...\n"
                        "       tool draw --list [OPTION]...\n\nOutputs:"));
  EXPECT_THAT(FormatHelp(DescribeCommand(draw_), 50),
              HasSubstr("\nUsage: tool draw FILE --out FILE (--to\n                NAME | --size N) [OPTION]...\n"
                        "       tool draw --list [OPTION]...\n\nOutputs:"));
  EXPECT_THAT(FormatHelp(DescribeCommand(draw_), 80), HasSubstr("\nA paragraph.\n"));
}

TEST_F(HelpTest, APositionalArgumentOfSeveralKindsIsNamedAfterThem) {
  CLI::App show("Show something", "show");
  CLI::Option* const what = show.add_option("what", file_, "A recording or a session")->type_name("FILE|SESSION");
  show.add_option("place", file_, "Where")->type_name("FILE");
  show.add_flag("--loop", is_quick_, "Begin again at the end")->needs(what);
  const std::string help = FormatHelp(DescribeCommand(show), 80);
  EXPECT_THAT(help, HasSubstr("Usage: show [FILE|SESSION] [PLACE] [OPTION]...\n"));
  EXPECT_THAT(help, HasSubstr("  FILE|SESSION            A recording or a session\n"));
  EXPECT_THAT(help, HasSubstr("Begin again at the end [with: FILE|SESSION]\n"));
}

TEST_F(HelpTest, LinesAreNotLongerThanTheWidth) {
  for (const size_t width : {40, 50, 72, 80, 100}) {
    for (const absl::string_view line : absl::StrSplit(FormatHelp(DescribeCommand(draw_), width), '\n')) {
      EXPECT_LE(line.size(), width) << line;
    }
  }
}

TEST_F(HelpTest, ListsCommandsByGroup) {
  app_.add_subcommand("list", "List the recordings")->group("Look");
  app_.add_subcommand("internal", "No help")->group("");
  const std::string help = FormatHelp(DescribeCommand(app_), 80);
  EXPECT_THAT(help, HasSubstr("Usage: tool COMMAND [OPTION]...\n"));
  EXPECT_THAT(help, HasSubstr("\nCommands:\n  draw  Draw a recording\n\nLook:\n  list  List the recordings\n"));
  EXPECT_THAT(help, HasSubstr("\n  2  Wrong usage")) << "the exit statuses of the project";
  EXPECT_THAT(help, Not(HasSubstr("internal")));
}

TEST_F(HelpTest, ExclusionsAreShownUnlessAnOptionExcludesMany) {
  CLI::Option* const scene = draw_.add_option("--scene", out_, "A whole scene");
  for (const char* const name : {"--a", "--b", "--c", "--d"}) draw_.add_flag(name, is_quick_, "Part")->excludes(scene);
  draw_.get_option("--a")->excludes("--b");
  const std::string help = FormatHelp(DescribeCommand(draw_), 80);
  EXPECT_THAT(help, HasSubstr("--a                     Part [not with: --b]\n"));
  EXPECT_THAT(help, HasSubstr("--c                     Part\n"));
  EXPECT_THAT(help, HasSubstr("--scene TEXT            A whole scene\n"));
}

TEST(TextWidthTest, IsThatOfTheVariableWithinLimits) {
  for (const auto& [columns, width] :
       std::vector<std::pair<const char*, size_t>>{{"60", 60}, {"1000", 100}, {"2", 40}, {"many", 80}, {"0", 80}}) {
    const ScopedEnvironmentVariable variable("COLUMNS", columns);
    EXPECT_EQ(TextWidth(-1), width) << columns;
  }
  EXPECT_EQ(TextWidth(-1), 80u) << "no terminal";
}

TEST(RunProgramTest, AnErrorOrAnExceptionEndsTheProgramWithAMessage) {
  EXPECT_EQ(RunProgram("evpose-test", [] { return absl::StatusOr<int>(2); }), 2);
  testing::internal::CaptureStderr();
  EXPECT_EQ(RunProgram("evpose-test", [] { return absl::StatusOr<int>(absl::DataLossError("the file is cut")); }), 1);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "evpose-test: the file is cut\n");
  testing::internal::CaptureStderr();
  EXPECT_EQ(RunProgram("evpose-test", []() -> absl::StatusOr<int> { throw std::runtime_error("no memory"); }), 1);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "evpose-test: no memory\n");
}

}  // namespace
}  // namespace evpose
