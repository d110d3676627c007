// SPDX-License-Identifier: Apache-2.0

// The command line of evpose-convert-step. It does not need OpenCASCADE.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>

namespace evpose::client {

struct StepArguments {
  std::string input;
  std::string output;  // empty: standard output
};

// Returns the parser, which writes to `arguments`.
std::unique_ptr<CLI::App> MakeStepParser(StepArguments& arguments);

}  // namespace evpose::client
