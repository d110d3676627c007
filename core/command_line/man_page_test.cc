// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/man_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose {
namespace {

using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::StartsWith;

HelpPage Page() {
  HelpPage page;
  page.name = "tool draw";
  page.description = "Draw a recording";
  page.usages = {"FILE [OPTION]...", "--list [OPTION]..."};
  page.groups = {{"Outputs",
                  {{.names = {"-o", "--out"},
                    .value = "FILE",
                    .description = ".png, 'quoted' or a\\b",
                    .facts = {"default: a.png"}}}}};
  page.notes = {{"", "A paragraph."}, {"", "Columns:"}, {"first", "what it is"}};
  page.exit_statuses = {{"0", "All"}};
  page.examples = {{"tool draw -o a.png", true}, {"then", false}, {"tool list", true}};
  return page;
}

TEST(ManPageTest, HasTheSectionsOfAManualPage) {
  const std::string page = FormatManPage(Page(), 1, "1.2.3", {"tool(1)", "tool-server(8)"});
  EXPECT_EQ(ManPageName(Page()), "tool-draw");
  EXPECT_THAT(page, StartsWith(".TH TOOL\\-DRAW 1 \"\" \"evpose 1.2.3\" \"evpose manual\"\n"));
  EXPECT_THAT(page, HasSubstr("\n.SH NAME\ntool\\-draw \\- draw a recording\n.SH SYNOPSIS\n"
                              "\\fBtool draw\\fR FILE [OPTION]...\n.br\n\\fBtool draw\\fR \\-\\-list [OPTION]...\n"));
  EXPECT_THAT(page, HasSubstr("\n.SS Outputs\n.TP\n\\fB\\-o\\fR, \\fB\\-\\-out\\fR \\fIFILE\\fR\n"));
  EXPECT_THAT(page, HasSubstr("\n.SH NOTES\nA paragraph.\n.PP\nColumns:\n.TP\n\\fBfirst\\fR\nwhat it is\n"));
  EXPECT_THAT(page, HasSubstr("\n.EX\ntool draw \\-o a.png\n.EE\n.PP\nthen\n.EX\ntool list\n.EE\n"));
  EXPECT_THAT(page, EndsWith("\\fBtool\\fR(1),\n\\fBtool\\-server\\fR(8)\n"));
}

TEST(ManPageTest, TextHasNoRequestsAndNoEscapes) {
  EXPECT_THAT(FormatManPage(Page(), 1, "1", {}),
              HasSubstr("\n\\&.png, \\(aqquoted\\(aq or a\\(rsb [default: a.png]\n"));
}

}  // namespace
}  // namespace evpose
