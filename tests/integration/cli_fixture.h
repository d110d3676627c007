// SPDX-License-Identifier: Apache-2.0

// The fixture of the end-to-end tests: a temporary directory, the command line as a function and as a program, and a
// short recording with its truth.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "evpose/clock.h"

namespace evpose {

struct CliResult {
  int status = -1;
  std::string out;
  std::string err;  // without the lines of WaitMessage, which depend on the speed of the machine

  nlohmann::json Json() const;
};

// Runs a command in this process. `act` is called once, as soon as its standard error contains `text`; with
// `is_interrupted_then`, the command is also interrupted at that moment. `err` of the result has all lines.
CliResult RunWatched(const std::vector<std::string>& arguments, const std::string& text,
                     const std::function<void()>& act, bool is_interrupted_then = false);

class CliTest : public ::testing::Test {
 protected:
  void SetUp() override;
  void TearDown() override;

  // A path in the test's directory.
  std::string Path(const std::string& name) const { return (directory_ / name).string(); }
  void WriteText(const std::string& name, const std::string& text) const;
  std::string ReadText(const std::string& name) const;
  // The files of the test's directory with names that begin with this, complete or temporary.
  std::vector<std::string> FilesBeginning(const std::string& prefix) const;

  // Calls RunCli() in this process; `clock` sets the pace of a replay.
  CliResult Run(const std::vector<std::string>& arguments, client::Clock* clock = nullptr) const;
  // Runs a shell in the test's directory, with `evpose` and `evpose-server` in its PATH. $HELP is the directory of the
  // manual pages and completions. `await CONDITION` in the script waits, with pauses and a bound, until this shell code
  // succeeds; it fails at once if process $pid has ended.
  CliResult RunShell(const std::string& script) const;

  // Writes cube/recording.raw, truth.tum, model.obj and camera.yaml: a cube in front of a VGA camera for `duration_s`.
  void SimulateCube(double duration_s) const;
  // The same files in another directory for a cylinder of so many sides, 0.08 m wide and 0.12 m high, which are flat as
  // the simulator draws them with `surface` as-is.
  void SimulateCylinder(const std::string& directory, int sides, const std::string& surface, double duration_s) const;
  // The pose of the truth's first line, in the format of --init-pose.
  std::string FirstPose(const std::string& directory = "cube") const;
  // The arguments of a replay of that recording, with that pose or without an initial pose.
  std::vector<std::string> ReplayArguments(const std::string& out, const std::vector<std::string>& more = {}) const;
  std::vector<std::string> SearchArguments(const std::string& out, const std::vector<std::string>& more = {}) const;

  std::filesystem::path directory_;
};

}  // namespace evpose
