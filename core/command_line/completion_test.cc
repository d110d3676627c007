// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/completion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"

namespace evpose {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;

class CompletionTest : public ::testing::Test {
 protected:
  CompletionTest() {
    app_.set_version_flag("--version", "1");
    CLI::App* const draw = app_.add_subcommand("draw", "Draw: a recording's [events]");
    draw->add_option("file", text_, "Recording")->type_name("FILE");
    draw->add_option("-o,--out", text_, "Picture")->type_name("FILE");
    draw->add_option("--object", texts_, "One of several objects")->type_name("ID=FILE")->allow_extra_args(false);
    draw->add_option("--to", text_, "Format")->check(CLI::IsMember({"png", "pdf"}));
    draw->add_option("--cache", text_, "Directory")->type_name("DIR");
    draw->add_option("--server", text_, "Address")->type_name("HOST:PORT");
    draw->add_flag("--json", flag_, "JSON");
    CLI::App* const server = app_.add_subcommand("server", "Servers");
    server->add_subcommand("list", "List them");
    server->add_subcommand("level", "Set it")->add_option("level", text_, "Level")->check(CLI::IsMember({"on", "off"}));
    std::filesystem::remove_all(directory_);
    std::filesystem::create_directories(directory_ / "models");
    for (const char* name : {"cube.raw", "a space.raw"}) const std::ofstream file(directory_ / name);
    std::ofstream(directory_ / "completion.bash") << BashCompletion(app_);
    std::ofstream(directory_ / "_tool") << ZshCompletion(app_);
  }
  ~CompletionTest() override { std::filesystem::remove_all(directory_); }

  std::string Output(const std::string& command) const {
    const std::string file = (directory_.parent_path() / (directory_.filename().string() + ".out")).string();
    EXPECT_EQ(std::system(absl::StrCat("cd '", directory_.string(), "' && ", command, " >'", file, "' 2>&1").c_str()),
              0);
    std::ifstream stream(file);
    std::string text{std::istreambuf_iterator<char>(stream), {}};
    std::filesystem::remove(file);
    return text;
  }

  // What bash offers for the last of the words, which readline has divided.
  std::vector<std::string> Complete(const std::vector<std::string>& words) const {
    std::vector<std::string> quoted;
    for (const std::string& word : words) quoted.push_back(absl::StrCat("'", word, "'"));
    std::ofstream(directory_ / "run.bash")
        << "source ./completion.bash\nCOMP_WORDS=(tool " << absl::StrJoin(quoted, " ")
        << ")\nCOMP_CWORD=" << words.size() << "\n_tool\nprintf '%s\\n' \"${COMPREPLY[@]}\"\n";
    return absl::StrSplit(Output("bash --norc run.bash"), '\n', absl::SkipEmpty());
  }

  std::string text_;
  std::vector<std::string> texts_;
  bool flag_ = false;
  CLI::App app_{"A tool", "tool"};
  // Cases run in parallel processes.
  const std::filesystem::path directory_ =
      std::filesystem::path(::testing::TempDir()) / absl::StrCat("evpose_completion_test_", getpid());
};

TEST_F(CompletionTest, BashCompletesCommandsAndOptions) {
  EXPECT_THAT(Complete({""}), ElementsAre("draw", "server"));
  EXPECT_THAT(Complete({"d"}), ElementsAre("draw"));
  EXPECT_THAT(Complete({"--ver"}), ElementsAre("--version"));
  EXPECT_THAT(Complete({"server", ""}), ElementsAre("list", "level"));
  EXPECT_THAT(Complete({"server", "level", ""}), ElementsAre("on", "off"));
  EXPECT_THAT(Complete({"draw", "--o"}), ElementsAre("--out", "--object"));
  EXPECT_THAT(Complete({"server", "list", ""}), ElementsAre("-h", "--help"));
  EXPECT_THAT(Complete({"nothing", "x"}), IsEmpty());
}

TEST_F(CompletionTest, BashCompletesValues) {
  EXPECT_THAT(Complete({"draw", "--to", ""}), ElementsAre("png", "pdf"));
  EXPECT_THAT(Complete({"draw", "cube.raw", "--to", "pn"}), ElementsAre("png"));
  EXPECT_THAT(Complete({"draw", "--to", "="}), ElementsAre("png", "pdf"));
  EXPECT_THAT(Complete({"draw", "--to", "=", "pd"}), ElementsAre("pdf"));
  EXPECT_THAT(Complete({"draw", "--server", ""}), IsEmpty()) << "an address is no file";
  EXPECT_THAT(Complete({"draw", "--json", "--to", "pdf", "--j"}), ElementsAre("--json"));
}

TEST_F(CompletionTest, BashCompletesFilesAndDirectories) {
  EXPECT_THAT(Complete({"draw", "cu"}), ElementsAre("cube.raw"));
  EXPECT_THAT(Complete({"draw", "a"}), ElementsAre("a space.raw"));
  EXPECT_THAT(Complete({"draw", "--json", "cu"}), ElementsAre("cube.raw")) << "a flag has no value";
  EXPECT_THAT(Complete({"draw", "-o", "m"}), ElementsAre("models"));
  EXPECT_THAT(Complete({"draw", "--object", "left", "=", "cu"}), ElementsAre("cube.raw"));
  EXPECT_THAT(Complete({"draw", "--cache", ""}), UnorderedElementsAre("models"));
}

TEST_F(CompletionTest, ZshAcceptsTheScript) {
  if (std::system("command -v zsh >/dev/null") != 0) GTEST_SKIP() << "zsh is not installed";
  EXPECT_EQ(Output("zsh -fn ./_tool"), "");
  // _arguments checks its specifications when it runs: outside of the completion they are passed to a stand-in.
  EXPECT_EQ(
      Output("zsh -fc '_arguments() { print -rl -- \"$@\" }; _files() { }; _describe() { }; words=(tool draw); source "
             "./_tool; _tool_draw' | grep -c -e '^(-o --out)--out=\\[Picture\\]:FILE:_files$' -e "
             "'^\\*--object=\\[One of several objects\\]:ID=FILE:_files$' -e "
             "'^(--to)--to=\\[Format\\]:NAME:(png pdf)$' -e '^(--server)--server=\\[Address\\]:HOST\\\\:PORT: $'"),
      "4\n");
}

}  // namespace
}  // namespace evpose
