// SPDX-License-Identifier: Apache-2.0
#include "server/program/health_check_arguments.h"

#include "core/command_line/help.h"
#include "core/command_line/number_range.h"

namespace evpose::server {
namespace {

constexpr char kHealthCheckNotes[] =
    "Exit status:\n"
    "  0  The server accepts sessions\n"
    "  1  It does not; the reason is on standard error\n"
    "  2  Wrong usage\n\n"
    "Example:\n"
    "  evpose-health-check 127.0.0.1:50051\n"
    "  evpose-health-check --tls-ca ca.crt --tls-name tracker.example.org 127.0.0.1:50051";

}  // namespace

std::unique_ptr<CLI::App> MakeHealthCheckParser(HealthCheckArguments& arguments) {
  auto parser = std::make_unique<CLI::App>("Check whether an evpose-server accepts sessions", "evpose-health-check");
  CLI::App& app = *parser;
  app.footer(kHealthCheckNotes);
  app.option_defaults()->always_capture_default();
  app.option_defaults()->group("Connection");
  app.add_option("address", arguments.address, "Address of the server, HOST:PORT")->type_name("HOST:PORT");
  app.add_option("--timeout", arguments.timeout_s, "Longest wait for a response")
      ->type_name("SECONDS")
      ->check(NumberRange(0.001, 3600.0));
  app.option_defaults()->group("Servers with TLS");
  app.add_option("--tls-ca", arguments.ca_file, "Authorities that may have signed the server's certificate, PEM")
      ->type_name("FILE")
      ->envname("EVPOSE_HEALTH_TLS_CA");
  app.add_option("--tls-cert", arguments.certificate_file,
                 "Client certificate, PEM, for a server that requires one (--tls-client-ca)")
      ->type_name("FILE")
      ->envname("EVPOSE_HEALTH_TLS_CERT");
  app.add_option("--tls-key", arguments.key_file, "Private key of that certificate, PEM")
      ->type_name("FILE")
      ->envname("EVPOSE_HEALTH_TLS_KEY");
  app.add_option("--tls-name", arguments.tls_name, "Name in the server's certificate if it is not HOST")
      ->type_name("NAME")
      ->envname("EVPOSE_HEALTH_TLS_NAME");
  UseHelp(app);
  return parser;
}

}  // namespace evpose::server
