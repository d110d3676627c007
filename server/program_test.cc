// evpose-server as its users meet it: what it prints, its exit statuses, its signals.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/strip.h"

extern char** environ;

namespace {

std::string Contents(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

std::string TemporaryPath(const std::string& name) {
  return testing::TempDir() + "/evpose_server_program_test." + std::to_string(getpid()) + "." + name;
}

// A running evpose-server; its standard output is a pipe, its standard error a file.
class Program {
 public:
  explicit Program(std::vector<std::string> arguments) : stderr_path_(TemporaryPath("stderr")) {
    arguments.insert(arguments.begin(), EVPOSE_SERVER);
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    int out[2];
    EXPECT_EQ(pipe(out), 0);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, out[1], STDOUT_FILENO);
    posix_spawn_file_actions_addclose(&actions, out[0]);
    posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, stderr_path_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    EXPECT_EQ(posix_spawn(&pid_, EVPOSE_SERVER, &actions, nullptr, argv.data(), environ), 0);
    posix_spawn_file_actions_destroy(&actions);
    close(out[1]);
    stdout_ = fdopen(out[0], "r");
  }
  ~Program() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      Wait();
    }
    fclose(stdout_);
    unlink(stderr_path_.c_str());
  }

  std::string ReadLine() {
    std::string line;
    for (int c = fgetc(stdout_); c != EOF && c != '\n'; c = fgetc(stdout_)) line.push_back(static_cast<char>(c));
    return line;
  }
  void Signal(int number) const { kill(pid_, number); }
  // The exit status, or minus the number of the signal that ended it.
  int Wait() {
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  std::string Stderr() const { return Contents(stderr_path_); }

 private:
  const std::string stderr_path_;
  pid_t pid_ = 0;
  FILE* stdout_ = nullptr;
};

TEST(ProgramTest, SaysWhereItListensAndLeavesAtASignal) {
  for (const int number : {SIGTERM, SIGINT}) {
    const std::string port_file = TemporaryPath("port");
    Program program({"--listen", "127.0.0.1:0", "--port-file", port_file});
    const std::string line = program.ReadLine();
    ASSERT_TRUE(absl::StartsWith(line, "listening on 127.0.0.1:")) << line;
    int port = 0;
    ASSERT_TRUE(absl::SimpleAtoi(line.substr(line.rfind(':') + 1), &port));
    EXPECT_GT(port, 0);
    EXPECT_EQ(Contents(port_file), std::to_string(port) + "\n");
    unlink(port_file.c_str());

    Program second({"--listen", "127.0.0.1:" + std::to_string(port)});
    EXPECT_EQ(second.Wait(), 1);
    const std::string error = second.Stderr();
    EXPECT_THAT(error, testing::MatchesRegex("evpose-server: cannot listen on 127.0.0.1:[0-9]+: .* in use\n"));

    program.Signal(number);
    EXPECT_EQ(program.Wait(), 0);
  }
}

TEST(ProgramTest, TellsWrongUsage) {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases = {
      {{"--no-such-option"}, "--no-such-option"}, {{"--listen", "nowhere"}, "has no port"},
      {{"--listen", "0.0.0.0:0"}, "--insecure"},  {{"--workers", "-1"}, "worker_threads"},
      {{"--max-sessions", "0"}, "max_sessions"},  {{"--log-level", "loud"}, "--log-level"},
  };
  for (const auto& [arguments, expected] : cases) {
    Program program(arguments);
    EXPECT_EQ(program.Wait(), 2) << expected;
    EXPECT_THAT(program.Stderr(), testing::HasSubstr(expected));
  }
}

TEST(ProgramTest, CannotWriteThePortFile) {
  Program program({"--listen", "127.0.0.1:0", "--port-file", "/no/such/directory/port"});
  EXPECT_EQ(program.Wait(), 1);
  EXPECT_THAT(program.Stderr(), testing::HasSubstr("/no/such/directory"));
}

TEST(ProgramTest, HelpShowsAnExample) {
  Program program({"--help"});
  std::string text;
  for (std::string line = program.ReadLine(); !absl::StrContains(line, "ends it at once"); line = program.ReadLine()) {
    text += line + "\n";
    ASSERT_LT(text.size(), 100'000u);
  }
  EXPECT_EQ(program.Wait(), 0);
  EXPECT_THAT(text, testing::HasSubstr("evpose-server --listen 127.0.0.1:50051"));
}

TEST(ProgramTest, ListensForOtherMachinesWhenToldTo) {
  Program program({"--listen", "0.0.0.0:0", "--insecure"});
  EXPECT_TRUE(absl::StartsWith(program.ReadLine(), "listening on 0.0.0.0:"));
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0);
}

}  // namespace
