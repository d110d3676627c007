// SPDX-License-Identifier: Apache-2.0

// Tests what the program says about itself: help, examples, manual pages, completion, and errors of usage.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <set>
#include <sstream>
#include <string>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "client/cli/cli.h"
#include "client/convert_hdf5/hdf5_arguments.h"
#include "client/convert_step/step_arguments.h"
#include "core/command_line/help.h"
#include "server/program/health_check_arguments.h"
#include "server/program/options.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/local_server_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

constexpr char kDefaultAddress[] = "127.0.0.1:50051";

// Returns the indented commands of a text, with continued lines joined.
std::vector<std::string> IndentedCommands(std::string text) {
  text = absl::StrReplaceAll(text, {{"\\\n", " "}});
  std::vector<std::string> commands;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.rfind("  ", 0) == 0) commands.push_back(line.substr(line.find_first_not_of(' ')));
  }
  EXPECT_FALSE(commands.empty()) << text;
  return commands;
}

// The error of `evpose view` in a build without node.
constexpr char kWithoutPage[] = "built without its page";

// The page is served until its command is ended.
std::string EndingCommand(const std::string& command) {
  const bool is_page = command.rfind("evpose view ", 0) == 0;
  return is_page ? absl::StrCat("timeout 2 ", command, " || test $? = 124") : command;
}

// Returns the commands below "Example:".
std::vector<std::string> Examples(const std::string& help) {
  const size_t begin = help.find("\nExample:\n");
  EXPECT_NE(begin, std::string::npos) << help;
  return IndentedCommands(help.substr(begin + 10));
}

TEST_F(CliTest, ExamplesOfEveryHelpWorkAsPrinted) {
  const LocalServer server = StartLocalServer();
  std::set<std::string> done;  // most begin with the same simulation
  // Commands that delete run after those that need the data, and the one that drains the server runs last.
  for (const char* command : {"",
                              "simulate",
                              "replay",
                              "stream",
                              "info",
                              "convert",
                              "camera",
                              "evaluate",
                              "render",
                              "doctor",
                              "view",
                              "models",
                              "models inspect",
                              "models upload",
                              "models list",
                              "models get",
                              "sessions",
                              "sessions list",
                              "sessions get",
                              "watch",
                              "sessions delete",
                              "models delete",
                              "bench",
                              "bench initialization",
                              "bench load",
                              "bench models",
                              "bench real",
                              "bench speed",
                              "bench synthetic",
                              "bench tracking",
                              "calibrate",
                              "target",
                              "server",
                              "server info",
                              "server log-level",
                              "sessions drain"}) {
    const CliResult help = RunShell(std::string("evpose ") + command + " --help");
    ASSERT_EQ(help.status, 0) << help.err;
    std::string script;
    for (const std::string& example : Examples(help.out)) {
      const bool sets_variable = example.find("=$(") != std::string::npos;
      if (!done.insert(example).second && !sets_variable) continue;
      // The server of this test listens on a port of its own.
      absl::StrAppend(&script, EndingCommand(absl::StrReplaceAll(example, {{kDefaultAddress, server.address}})), "\n");
    }
    const CliResult result = RunShell(script);
    if (result.err.find(kWithoutPage) != std::string::npos) continue;
    EXPECT_EQ(result.status, 0) << script << "\n" << result.err;
  }
  EXPECT_TRUE(std::filesystem::exists(Path("cube/poses.tum")));
  EXPECT_TRUE(std::filesystem::exists(Path("cube/picture.png")));
  EXPECT_TRUE(std::filesystem::exists(Path("sensor.yaml")));
  EXPECT_TRUE(std::filesystem::exists(Path("residuals.png")));
}

TEST_F(CliTest, TheFirstStepsWorkAsPrinted) {
  const CliResult first = RunShell("evpose || test $? -eq 2");
  ASSERT_EQ(first.status, 0) << first.err;
  EXPECT_EQ(first.out, "");
  const std::vector<std::string> commands = IndentedCommands(first.err);
  EXPECT_EQ(commands.size(), 3u);
  EXPECT_THAT(first.err, HasSubstr("evpose --help lists all commands"));
  for (const std::string& command : commands) {
    const CliResult result = RunShell(EndingCommand(command));
    if (result.err.find(kWithoutPage) != std::string::npos) continue;
    EXPECT_EQ(result.status, 0) << command << "\n" << result.err;
  }
}

void ExpectCompleteHelp(const CLI::App& program) {
  const std::set<std::string> statuses = {"0", "1", "2"};
  for (const CLI::App* const command : AllCommands(program)) {
    const HelpPage page = DescribeCommand(*command);
    const std::string help = FormatHelp(page, 80);
    std::istringstream lines(help);
    for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 80u) << page.name << ": " << line;
    EXPECT_FALSE(page.examples.empty()) << page.name;
    std::set<std::string> stated;
    for (const HelpNote& status : page.exit_statuses) stated.insert(status.term);
    EXPECT_EQ(stated, statuses) << page.name;
    for (const std::string& usage : page.usages) {
      for (const absl::string_view word : absl::StrSplit(usage, absl::ByAnyChar(" ()[]"))) {
        if (!absl::StartsWith(word, "--")) continue;
        EXPECT_NE(command->get_option_no_throw(std::string(word)), nullptr) << page.name << ": " << usage;
      }
    }
    EXPECT_EQ(page.groups.back().title == kResearchGroup || page.groups.back().title == kGeneralGroup, true)
        << page.name << ": research options are last";
    for (const HelpGroup& group : page.groups) {
      for (const HelpOption& option : group.options) {
        const std::string text = absl::StrCat(page.name, ": ", option.Term(), "  ", option.description);
        EXPECT_TRUE(group.title != "Options") << text << ": has no group";
        EXPECT_TRUE(option.value != "TEXT" && option.value != "NUMBER") << text << ": states no unit or kind";
        ASSERT_FALSE(option.description.empty()) << text;
        EXPECT_FALSE(absl::EndsWith(option.description, ".")) << text;
        const char first = option.description.front();
        const bool is_term = absl::StrContains(option.description.substr(0, 20), ": ") || first == '"';
        EXPECT_TRUE(!absl::ascii_islower(first) || is_term) << text;
      }
    }
  }
}

TEST_F(CliTest, HelpOfEveryCommandIsComplete) {
  std::ostringstream out, err;
  client::CliContext context{out, err};
  client::CommandRunners runners;
  ExpectCompleteHelp(*client::MakeParser(context, runners));
  client::StepArguments step;
  ExpectCompleteHelp(*client::MakeStepParser(step));
  client::Hdf5Arguments hdf5;
  ExpectCompleteHelp(*client::MakeHdf5Parser(hdf5));
  server::HealthCheckArguments health_check;
  ExpectCompleteHelp(*server::MakeHealthCheckParser(health_check));
  server::UseParser([](const CLI::App& program) { ExpectCompleteHelp(program); });
}

TEST_F(CliTest, UsageHasOptionsOfWhichOneIsRequired) {
  EXPECT_THAT(Run({"replay", "--help"}).out,
              HasSubstr("Usage: evpose replay RECORDING --camera FILE (--model FILE | --object\n                ID=FILE"
                        " ...) [OPTION]...\n"));
  const std::string view = Run({"view", "--help"}).out;
  EXPECT_THAT(view, HasSubstr("\n       evpose view [SESSION] --server HOST:PORT [OPTION]...\n"));
  EXPECT_THAT(view, HasSubstr("\n  FILE|SESSION            Recording: "));
}

TEST_F(CliTest, CommandsAreListedByPurpose) {
  const std::string help = Run({"--help"}).out;
  for (const char* const purpose : {"Track objects:\n  replay ", "Recordings and poses:\n  simulate ",
                                    "Cameras and models:\n", "Servers:\n", "Research:\n  bench "}) {
    EXPECT_THAT(help, HasSubstr(purpose));
  }
}

TEST_F(CliTest, ManualPagesAndCompletionsHaveNoErrors) {
  // groff -ww reports every problem of a page; bash -n and zsh -n check the syntax.
  const CliResult pages = RunShell(
      "test -e $HELP/man1/evpose-sessions-list.1\ntest -e $HELP/man1/evpose-hdf5.1\n"
      "test -e $HELP/man8/evpose-health-check.8\n"
      "for page in $HELP/man1/*.1 $HELP/man8/*.8; do groff -man -Tutf8 -ww -z \"$page\" || exit 1; done\n"
      "bash -n $HELP/bash/evpose\nbash -n $HELP/bash/evpose-server\n"
      "if command -v zsh >/dev/null; then zsh -fn $HELP/zsh/_evpose; zsh -fn $HELP/zsh/_evpose-server; fi\n"
      "if command -v mandoc >/dev/null; then mandoc -T lint -W error $HELP/man1/*.1 $HELP/man8/*.8; fi");
  EXPECT_EQ(pages.status, 0);
  EXPECT_EQ(pages.out, "");
  EXPECT_EQ(pages.err, "");
}

TEST_F(CliTest, BashCompletesTheProgram) {
  const auto complete = [this](const std::string& words, int index) {
    WriteText("complete.bash", absl::StrCat("source $HELP/bash/evpose\nCOMP_WORDS=(evpose ", words, ")\nCOMP_CWORD=",
                                            index, "\n_evpose\nprintf '%s\\n' \"${COMPREPLY[@]}\"\n"));
    const CliResult result = RunShell("bash --norc complete.bash");
    EXPECT_EQ(result.err, "");
    return result.out;
  };
  WriteText("cube.raw", "");
  EXPECT_EQ(complete("re", 1), "replay\nrender\n");
  EXPECT_EQ(complete("sessions dr", 2), "drain\n");
  EXPECT_EQ(complete("replay cu", 2), "cube.raw\n");
  EXPECT_EQ(complete("replay cube.raw --cam", 3), "--camera\n");
  EXPECT_EQ(complete("replay cube.raw --surface ''", 4), "smooth\nas-is\n");
  EXPECT_EQ(complete("server log-level w", 3), "warning\n");
}

TEST_F(CliTest, NamesAnUnknownCommand) {
  const CliResult command = Run({"frobnicate", "--json"});
  EXPECT_EQ(command.status, 2);
  EXPECT_EQ(command.err, "evpose: there is no command \"frobnicate\"; evpose --help lists the commands\n");
  const CliResult below = Run({"sessions", "remove", "sessions/a"});
  EXPECT_EQ(below.status, 2);
  EXPECT_THAT(below.err, HasSubstr("evpose sessions: there is no command \"remove\"; evpose sessions --help"));
  EXPECT_EQ(Run({}).status, 2);
  const CliResult missing = Run({"sessions"});
  EXPECT_EQ(missing.status, 2);
  EXPECT_EQ(missing.err,
            "evpose sessions: give a command: list, get, delete, drain; evpose sessions --help lists the commands\n");
}

TEST_F(CliTest, SuggestsTheNearestNames) {
  EXPECT_EQ(Run({"reply", "a.raw"}).err,
            "evpose: there is no command \"reply\"; did you mean replay? evpose --help lists the commands\n");
  EXPECT_THAT(Run({"sessions", "lst"}).err,
              HasSubstr("; did you mean list? evpose sessions --help lists the commands\n"));
  EXPECT_THAT(Run({"info", "a.raw", "--jsn"}).err,
              HasSubstr("--jsn; did you mean --json? evpose info --help lists the options\n"));
}

TEST_F(CliTest, ErrorsOfTheArgumentsBeginWithTheCommand) {
  for (const auto& [arguments, expected] : std::vector<std::pair<std::vector<std::string>, std::string>>{
           {{"replay", "--frobnicate"}, "evpose replay: "},
           {{"sessions", "list"}, "evpose sessions list: "},
           {{"target", "--out", "a.txt"}, "evpose target: "}}) {
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, 2);
    EXPECT_THAT(result.err, ::testing::StartsWith(expected));
    const std::string advice = expected.substr(0, expected.size() - 2) + " --help lists the options\n";
    EXPECT_THAT(result.err, ::testing::EndsWith("; " + advice));
    EXPECT_THAT(result.err, ::testing::Not(::testing::HasSubstr("not expected"))) << "the words of the project";
  }
}

}  // namespace
}  // namespace evpose
