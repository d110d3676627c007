// SPDX-License-Identifier: Apache-2.0

// The command line of evpose-hdf5. It does not need the HDF5 library.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>

namespace evpose::client {

struct Hdf5Arguments {
  std::string action;  // "read" or "write"
  std::string path;
};

// Returns the parser, which writes to `arguments`.
std::unique_ptr<CLI::App> MakeHdf5Parser(Hdf5Arguments& arguments);

}  // namespace evpose::client
