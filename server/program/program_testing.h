// SPDX-License-Identifier: Apache-2.0

// Runs evpose-server as a process in tests.
#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace evpose::server {

inline std::string Contents(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

inline std::string TemporaryPath(const std::string& name) {
  return testing::TempDir() + "/evpose_server_program_test." + std::to_string(getpid()) + "." + name;
}

// A running evpose-server, or another program with its options; its standard output is a pipe, its standard error a
// file.
class Program {
 public:
  explicit Program(std::vector<std::string> arguments, const char* program = EVPOSE_SERVER)
      : stderr_path_(TemporaryPath("stderr." + std::to_string(++num_started_))) {
    // By default the server stores in memory, so that it leaves no files and shares nothing with other tests.
    const bool has_store = std::find(arguments.begin(), arguments.end(), "--store") != arguments.end();
    if (!has_store && std::getenv("EVPOSE_STORE") == nullptr) {
      arguments.insert(arguments.begin(), {"--store", "memory"});
    }
    arguments.insert(arguments.begin(), program);
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
    EXPECT_EQ(posix_spawn(&pid_, program, &actions, nullptr, argv.data(), environ), 0);
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

  pid_t pid() const { return pid_; }
  std::string ReadLine() {
    std::string line;
    for (int c = fgetc(stdout_); c != EOF && c != '\n'; c = fgetc(stdout_)) line.push_back(static_cast<char>(c));
    return line;
  }
  void Signal(int number) const { kill(pid_, number); }
  // Repeats the signal until the process has ended, because the process may not have installed its handler yet.
  void SignalUntilExit(int number) const {
    siginfo_t info = {};
    while (info.si_pid == 0) {
      kill(pid_, number);
      waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT);
    }
  }
  // Waits for the end. Returns the exit status, or minus the number of the signal that ended the process.
  int Wait() {
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  std::string Stderr() const { return Contents(stderr_path_); }

 private:
  static inline std::atomic<int> num_started_ = 0;
  const std::string stderr_path_;
  pid_t pid_ = 0;
  FILE* stdout_ = nullptr;
};

}  // namespace evpose::server
