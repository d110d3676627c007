// SPDX-License-Identifier: Apache-2.0
#include "tests/integration/cli_fixture.h"

#include <sys/wait.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <numbers>
#include <sstream>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/cli.h"

namespace evpose {
namespace {

std::string ReadWhole(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

// What a command prints. Calls `act` once, as soon as it contains `text`.
class WatchedBuffer : public std::stringbuf {
 public:
  WatchedBuffer(std::string text, std::function<void()> act) : text_(std::move(text)), act_(std::move(act)) {}

 protected:
  int sync() override {
    if (!has_acted_ && absl::StrContains(str(), text_)) {
      has_acted_ = true;
      act_();
    }
    return 0;
  }

 private:
  const std::string text_;
  const std::function<void()> act_;
  bool has_acted_ = false;
};

}  // namespace

CliResult RunWatched(const std::vector<std::string>& arguments, const std::string& text,
                     const std::function<void()>& act, bool is_interrupted_then) {
  std::atomic<bool> is_interrupted = false;
  WatchedBuffer buffer(text, [&] {
    is_interrupted = is_interrupted_then;
    act();
  });
  std::ostringstream out;
  std::ostream err(&buffer);
  client::CliContext context{out, err};
  context.is_interrupted = [&] { return is_interrupted.load(); };
  const int status = client::RunCli(arguments, context);
  return {status, out.str(), buffer.str()};
}

nlohmann::json CliResult::Json() const {
  nlohmann::json json = nlohmann::json::parse(out, nullptr, false);
  EXPECT_FALSE(json.is_discarded()) << out << err;
  return json;
}

void CliTest::SetUp() {
  const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
  std::string name = std::string(info->test_suite_name()) + "." + info->name();
  std::replace(name.begin(), name.end(), '/', '.');
  directory_ = std::filesystem::path(::testing::TempDir()) / ("evpose_" + name);
  std::filesystem::remove_all(directory_);
  std::filesystem::create_directories(directory_);
}

void CliTest::TearDown() {
  if (!HasFailure()) std::filesystem::remove_all(directory_);
}

void CliTest::WriteText(const std::string& name, const std::string& text) const {
  std::ofstream(Path(name), std::ios::binary) << text;
}

std::string CliTest::ReadText(const std::string& name) const { return ReadWhole(Path(name)); }

std::vector<std::string> CliTest::FilesBeginning(const std::string& prefix) const {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(directory_)) {
    const std::string name = entry.path().filename().string();
    if (name.rfind(prefix, 0) == 0) names.push_back(name);
  }
  return names;
}

namespace {

// Returns whether a command states in this line for what it waits, or what it is doing (client/cli/console).
bool IsWait(const std::string& line) {
  if (!absl::EndsWith(line, " ...")) return false;
  const auto begins_with = [&line](const char* prefix) { return absl::StartsWith(line, prefix); };
  return begins_with("waiting for ") || begins_with("reading ") || begins_with("inspecting ") ||
         begins_with("comparing with ");
}

// Returns `err` without these lines, because they depend on the speed of the machine.
std::string WithoutWaits(const std::string& err) {
  std::string rest;
  std::istringstream lines(err);
  for (std::string line; std::getline(lines, line);) {
    if (!IsWait(line)) rest += line + (lines.eof() ? "" : "\n");
  }
  return rest;
}

}  // namespace

CliResult CliTest::Run(const std::vector<std::string>& arguments, client::Clock* clock) const {
  std::ostringstream out, err;
  client::CliContext context{out, err};
  context.clock = clock;
  CliResult result;
  result.status = client::RunCli(arguments, context);
  result.out = out.str();
  result.err = WithoutWaits(err.str());
  return result;
}

CliResult CliTest::RunShell(const std::string& script) const {
  // A process that has ended has no executable, even before `wait`.
  static constexpr char kAwait[] =
      "await() {\n"
      "  attempts=0\n"
      "  until eval \"$1\"; do\n"
      "    test -e /proc/$pid/exe || { echo \"process $pid has ended before: $1\" >&2; exit 1; }\n"
      "    test $((attempts += 1)) -lt 20000 || { echo \"waited too long for: $1\" >&2; exit 1; }\n"
      "    sleep 0.01\n"
      "  done\n"
      "}\n";
  WriteText("script.sh", kAwait + script);
  const std::string command = "cd '" + directory_.string() +
                              "' && HELP='" EVPOSE_HELP_DIRECTORY
                              "' XDG_STATE_HOME=\"$PWD/state\" PATH='" EVPOSE_BINARY_DIRECTORIES
                              "':\"$PATH\" sh -e script.sh >shell.out 2>shell.err </dev/null";
  const int wait_status = std::system(command.c_str());
  CliResult result;
  result.status = WIFEXITED(wait_status) ? WEXITSTATUS(wait_status) : -1;
  result.out = ReadText("shell.out");
  result.err = WithoutWaits(ReadText("shell.err"));
  return result;
}

void CliTest::SimulateCube(double duration_s) const {
  const CliResult result = Run({"simulate", "--object", "cube", "--camera", "vga", "--duration",
                                std::to_string(duration_s), "--noise", "0.1", "--out", Path("cube")});
  ASSERT_EQ(result.status, 0) << result.err;
}

void CliTest::SimulateCylinder(const std::string& directory, int sides, const std::string& surface,
                               double duration_s) const {
  std::string obj, bottom, top, walls;
  for (const double z : {-0.06, 0.06}) {
    for (int i = 0; i < sides; ++i) {
      const double angle = 2.0 * std::numbers::pi * i / sides;
      absl::StrAppendFormat(&obj, "v %.9g %.9g %g\n", 0.04 * std::cos(angle), 0.04 * std::sin(angle), z);
    }
  }
  for (int i = 1; i <= sides; ++i) {
    const int next = i % sides + 1;
    absl::StrAppend(&bottom, " ", sides + 1 - i);
    absl::StrAppend(&top, " ", sides + i);
    absl::StrAppendFormat(&walls, "f %d %d %d %d\n", i, next, sides + next, sides + i);
  }
  WriteText(directory + ".obj", absl::StrCat(obj, "f", bottom, "\nf", top, "\n", walls));
  const CliResult result =
      Run({"simulate", "--model", Path(directory + ".obj"), "--surface", surface, "--camera", "vga", "--duration",
           std::to_string(duration_s), "--path-seed", "4", "--out", Path(directory)});
  ASSERT_EQ(result.status, 0) << result.err;
}

std::string CliTest::FirstPose(const std::string& directory) const {
  const std::string truth = ReadText(directory + "/truth.tum");
  const std::string line = truth.substr(0, truth.find('\n'));
  return line.substr(line.find(' ') + 1);
}

std::vector<std::string> CliTest::ReplayArguments(const std::string& out, const std::vector<std::string>& more) const {
  std::vector<std::string> arguments = SearchArguments(out, {"--init-pose", FirstPose()});
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

std::vector<std::string> CliTest::SearchArguments(const std::string& out, const std::vector<std::string>& more) const {
  std::vector<std::string> arguments = {"replay",   Path("cube/recording.raw"), "--model", Path("cube/model.obj"),
                                        "--camera", Path("cube/camera.yaml"),   "--out",   Path(out),
                                        "--json"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

}  // namespace evpose
