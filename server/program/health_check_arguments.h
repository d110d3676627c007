// SPDX-License-Identifier: Apache-2.0

// The command line of evpose-health-check, for the program and its manual page.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>

namespace evpose::server {

struct HealthCheckArguments {
  std::string address = "127.0.0.1:50051";
  double timeout_s = 3.0;
  std::string ca_file;
  std::string certificate_file;
  std::string key_file;
  std::string tls_name;
  bool has_tls() const { return !ca_file.empty() || !certificate_file.empty() || !tls_name.empty(); }
};

// `arguments` must outlive the parser.
std::unique_ptr<CLI::App> MakeHealthCheckParser(HealthCheckArguments& arguments);

}  // namespace evpose::server
