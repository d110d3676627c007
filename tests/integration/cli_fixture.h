// SPDX-License-Identifier: Apache-2.0

// What the end-to-end tests share: a directory of their own, the command line as a function and as a program, a short
// recording with its truth.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "evpose/clock.h"

namespace evpose {

struct CliResult {
  int status = -1;
  std::string out;
  std::string err;

  nlohmann::json Json() const;
};

class CliTest : public ::testing::Test {
 protected:
  void SetUp() override;
  void TearDown() override;

  // A path in the test's directory.
  std::string Path(const std::string& name) const { return (directory_ / name).string(); }
  void WriteText(const std::string& name, const std::string& text) const;
  std::string ReadText(const std::string& name) const;
  // The files of the test's directory whose names begin so, whole or half-written.
  std::vector<std::string> FilesBeginning(const std::string& prefix) const;

  // RunCli() in this process; `clock` paces a replay.
  CliResult Run(const std::vector<std::string>& arguments, client::Clock* clock = nullptr) const;
  // A shell in the test's directory that finds `evpose` and `evpose-server` by name.
  CliResult RunShell(const std::string& script) const;

  // cube/recording.raw, truth.tum, model.obj and camera.yaml: `duration_s` of a cube before a VGA camera.
  void SimulateCube(double duration_s) const;
  // The pose of the truth's first line, as --init-pose takes it.
  std::string FirstPose() const;
  // The arguments of a replay of that recording, from that pose or from the events alone.
  std::vector<std::string> ReplayArguments(const std::string& out, const std::vector<std::string>& more = {}) const;
  std::vector<std::string> SearchArguments(const std::string& out, const std::vector<std::string>& more = {}) const;

  std::filesystem::path directory_;
};

}  // namespace evpose
