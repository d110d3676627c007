// SPDX-License-Identifier: Apache-2.0

// Runs a program as a process in tests.
#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "core/base/poll_testing.h"

namespace evpose {

inline std::string Contents(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

struct ProcessFiles {
  int in = -1;      // the standard input; by default /dev/null
  std::string out;  // the file of the standard output, which is otherwise a pipe
};

// A running program. Its standard error is a file. The process is killed with the object.
class TestProcess {
 public:
  // `command`: the path of the program and its arguments.
  explicit TestProcess(std::vector<std::string> command, const ProcessFiles& files = {})
      : stderr_path_(testing::TempDir() + "/evpose_test_process." + std::to_string(getpid()) + "." +
                     std::to_string(++num_started_)) {
    std::vector<char*> argv;
    for (std::string& word : command) argv.push_back(word.data());
    argv.push_back(nullptr);
    int out[2] = {-1, -1};
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    if (files.in < 0) {
      posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    } else {
      posix_spawn_file_actions_adddup2(&actions, files.in, STDIN_FILENO);
    }
    constexpr int kNew = O_WRONLY | O_CREAT | O_TRUNC;
    if (files.out.empty()) {
      // No other process may have the writing end, because ReadLine() would not see the end of this one.
      EXPECT_EQ(pipe2(out, O_CLOEXEC), 0);
      posix_spawn_file_actions_adddup2(&actions, out[1], STDOUT_FILENO);
      stdout_ = fdopen(out[0], "r");
    } else {
      posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, files.out.c_str(), kNew, 0600);
    }
    posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, stderr_path_.c_str(), kNew, 0600);
    if (posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ) != 0) {
      pid_ = 0;
      ADD_FAILURE() << "cannot start " << command[0];
    }
    posix_spawn_file_actions_destroy(&actions);
    if (out[1] >= 0) close(out[1]);
  }
  ~TestProcess() {
    Signal(SIGKILL);
    Wait();
    if (stdout_ != nullptr) fclose(stdout_);
    unlink(stderr_path_.c_str());
  }
  TestProcess(const TestProcess&) = delete;
  TestProcess& operator=(const TestProcess&) = delete;

  pid_t pid() const { return pid_; }
  // The next line of the standard output without its end; empty at the end of the process.
  std::string ReadLine() {
    std::string line;
    for (int c = fgetc(stdout_); c != EOF && c != '\n'; c = fgetc(stdout_)) line.push_back(static_cast<char>(c));
    return line;
  }
  void Signal(int number) const {
    if (pid_ > 0) kill(pid_, number);  // process ID 0 would signal this process and its group
  }
  // Repeats the signal until the process has ended, because the process may not have installed its handler yet.
  void SignalUntilExit(int number) const {
    siginfo_t info = {};
    EXPECT_TRUE(Poll([&] {
      kill(pid_, number);
      waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT);
      return info.si_pid != 0;
    }));
  }
  bool IsRunning() {
    if (pid_ > 0 && waitpid(pid_, &status_, WNOHANG) == pid_) pid_ = 0;
    return pid_ > 0;
  }
  // Waits for the end. Returns the exit status, or minus the number of the signal that ended the process.
  int Wait() {
    if (pid_ > 0) waitpid(pid_, &status_, 0);
    pid_ = 0;
    return WIFEXITED(status_) ? WEXITSTATUS(status_) : -WTERMSIG(status_);
  }
  std::string Stderr() const { return Contents(stderr_path_); }

 private:
  static inline std::atomic<int> num_started_ = 0;
  const std::string stderr_path_;
  pid_t pid_ = 0;
  int status_ = 0;
  FILE* stdout_ = nullptr;
};

}  // namespace evpose
