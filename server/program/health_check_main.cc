// SPDX-License-Identifier: Apache-2.0

// evpose-health-check: see --help.
#include <grpcpp/grpcpp.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdlib>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/time/clock.h"
#include "core/base/certificates.h"
#include "core/base/status_macros.h"
#include "core/command_line/help.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "server/connections/listen_address.h"
#include "server/program/health_check_arguments.h"

namespace {

using evpose::server::HealthCheckArguments;
using grpc::health::v1::HealthCheckResponse;

constexpr int kFailed = 1;
constexpr int kWrongUsage = 2;

// Checks the arguments without opening files. Returns the error, or an empty string.
std::string WrongUsage(const HealthCheckArguments& arguments) {
  const auto address = evpose::server::ParseListenAddress(arguments.address);
  if (!address.ok()) return std::string(address.status().message());
  if (address->port == 0)
    return absl::StrCat(arguments.address,
                        ": port 0 is not a server's port; give the port on which the server listens");
  if (arguments.certificate_file.empty() == arguments.key_file.empty()) return "";
  return "--tls-cert and --tls-key belong together: give both";
}

absl::StatusOr<std::shared_ptr<grpc::ChannelCredentials>> MakeCredentials(const HealthCheckArguments& arguments) {
  if (!arguments.has_tls()) return grpc::InsecureChannelCredentials();
  EVPOSE_ASSIGN_OR_RETURN(evpose::ClientPem pem, evpose::ReadClientPem(arguments.ca_file, arguments.certificate_file,
                                                                       arguments.key_file, absl::Now()));
  return grpc::SslCredentials({.pem_root_certs = std::move(pem.authorities),
                               .pem_private_key = std::move(pem.key),
                               .pem_cert_chain = std::move(pem.certificate)});
}

std::string WhyNoAnswer(const HealthCheckArguments& arguments, const grpc::Status& status) {
  const std::string what = status.error_message().empty() ? "no reason was given" : status.error_message();
  switch (status.error_code()) {
    case grpc::StatusCode::DEADLINE_EXCEEDED:
      return absl::StrCat("did not respond within ", arguments.timeout_s, " s");
    case grpc::StatusCode::UNIMPLEMENTED:
      return "has no gRPC health service: is this evpose-server's port?";
    case grpc::StatusCode::UNAVAILABLE:
      if (absl::StrContains(what, "Connection refused")) return "cannot be reached: no server listens on this port";
      return absl::StrCat("cannot be reached (", what, "): check that the server runs",
                          arguments.has_tls() ? ", uses TLS, and that the certificates are right"
                                              : " without TLS; for a server with TLS give --tls-ca");
    default:
      return absl::StrCat("failed: ", what);
  }
}

// Asks the server for its health. An error explains why the server accepts no sessions.
absl::Status Check(const HealthCheckArguments& arguments) {
  EVPOSE_ASSIGN_OR_RETURN(const auto credentials, MakeCredentials(arguments));
  grpc::ChannelArguments channel_arguments;
  channel_arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  if (!arguments.tls_name.empty()) channel_arguments.SetSslTargetNameOverride(arguments.tls_name);
  const auto channel = grpc::CreateCustomChannel(arguments.address, credentials, channel_arguments);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() +
                       absl::ToChronoMilliseconds(absl::Seconds(arguments.timeout_s)));
  HealthCheckResponse response;
  const grpc::Status status = grpc::health::v1::Health::NewStub(channel)->Check(&context, {}, &response);
  if (!status.ok()) {
    return absl::UnavailableError(absl::StrCat(arguments.address, " ", WhyNoAnswer(arguments, status)));
  }
  if (response.status() == HealthCheckResponse::SERVING) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat(arguments.address, " is ", HealthCheckResponse::ServingStatus_Name(response.status()),
                   ": it is shutting down, or its store does not respond; see its log or /readyz (--metrics-listen)"));
}

int Fail(int exit_status, const std::string& cause) {
  // A message of gRPC may have several lines.
  std::cerr << "evpose-health-check: " << absl::StrReplaceAll(absl::StripAsciiWhitespace(cause), {{"\n", " "}})
            << std::endl;
  return exit_status;
}

int Main(int argc, char** argv) {
  // The line of output has the reason of a failed connection already.
  // NOLINTNEXTLINE(concurrency-mt-unsafe): no other thread runs yet
  setenv("GRPC_VERBOSITY", "NONE", 0);
  HealthCheckArguments arguments;
  const std::unique_ptr<CLI::App> app = evpose::server::MakeHealthCheckParser(arguments);
  if (const std::optional<int> status = evpose::ParseOrAnswer(*app, argc, argv)) return *status;
  if (const std::string wrong = WrongUsage(arguments); !wrong.empty()) return Fail(kWrongUsage, wrong);
  const absl::Status checked = Check(arguments);
  return checked.ok() ? 0 : Fail(kFailed, std::string(checked.message()));
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return Main(argc, argv);
  } catch (const std::exception& error) {
    return Fail(kFailed, error.what());
  }
}
