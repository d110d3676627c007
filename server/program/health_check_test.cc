// SPDX-License-Identifier: Apache-2.0

// Tests exit status and output of evpose-health-check, which container engines and scripts use.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/certificates_testing.h"
#include "grpc/health/v1/health.grpc.pb.h"
#include "server/auth/files_testing.h"
#include "server/program/program_testing.h"

namespace evpose::server {
namespace {

using grpc::health::v1::HealthCheckRequest;
using grpc::health::v1::HealthCheckResponse;
using testing::HasSubstr;

struct Result {
  int status = -1;
  std::string text;  // standard output and error
};

// `environment`: assignments as before a command in a shell.
Result Check(const std::string& arguments, const std::string& environment = "") {
  FILE* const pipe = popen((environment + " " + EVPOSE_HEALTH_CHECK + " " + arguments + " 2>&1").c_str(), "r");
  Result result;
  for (int c = fgetc(pipe); c != EOF; c = fgetc(pipe)) result.text.push_back(static_cast<char>(c));
  const int status = pclose(pipe);
  if (WIFEXITED(status)) result.status = WEXITSTATUS(status);
  return result;
}

void ExpectHealthy(const Result& result) {
  EXPECT_EQ(result.status, 0);
  EXPECT_EQ(result.text, "");
}

void ExpectOneLine(const Result& result, int status, const std::string& expected) {
  EXPECT_EQ(result.status, status) << result.text;
  EXPECT_THAT(result.text, HasSubstr(expected));
  EXPECT_THAT(result.text, testing::StartsWith("evpose-health-check: "));
  EXPECT_THAT(result.text, testing::EndsWith("\n"));
  EXPECT_EQ(std::count(result.text.begin(), result.text.end(), '\n'), 1) << result.text;
}

// Reports the same status for every check.
class ScriptedHealth final : public grpc::health::v1::Health::Service {
 public:
  explicit ScriptedHealth(HealthCheckResponse::ServingStatus status) : status_(status) {}
  grpc::Status Check(grpc::ServerContext*, const HealthCheckRequest*, HealthCheckResponse* response) override {
    response->set_status(status_);
    return grpc::Status::OK;
  }

 private:
  const HealthCheckResponse::ServingStatus status_;
};

// A gRPC server with this service, on a free port.
struct ScriptedServer {
  explicit ScriptedServer(grpc::Service& service) {
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(&service);
    server = builder.BuildAndStart();
  }
  std::string address() const { return absl::StrCat("127.0.0.1:", port); }
  int port = 0;
  std::unique_ptr<grpc::Server> server;
};

TEST(HealthCheckTest, AServerThatAcceptsSessionsIsHealthy) {
  Program program({"--listen", "127.0.0.1:0"});
  ExpectHealthy(Check(program.Announced("listening on ")));
}

TEST(HealthCheckTest, ReportsTheReasonForNotServing) {
  ScriptedHealth not_serving(HealthCheckResponse::NOT_SERVING);
  const ScriptedServer leaving(not_serving);
  ExpectOneLine(Check(leaving.address()), 1, "is NOT_SERVING: it is shutting down, or its store does not respond");

  ScriptedHealth unknown(HealthCheckResponse::UNKNOWN);
  const ScriptedServer starting(unknown);
  ExpectOneLine(Check(starting.address()), 1, "is UNKNOWN");

  grpc::health::v1::Health::Service nothing;  // UNIMPLEMENTED
  const ScriptedServer other(nothing);
  ExpectOneLine(Check(other.address()), 1, "is this evpose-server's port?");
}

TEST(HealthCheckTest, ReportsAServerThatDoesNotRespond) {
  const int listener = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  ASSERT_EQ(bind(listener, reinterpret_cast<sockaddr*>(&address), size), 0);
  ASSERT_EQ(getsockname(listener, reinterpret_cast<sockaddr*>(&address), &size), 0);
  const std::string target = absl::StrCat("127.0.0.1:", ntohs(address.sin_port));
  ExpectOneLine(Check(target), 1, target + " cannot be reached: no server listens on this port\n");
  ASSERT_EQ(listen(listener, 1), 0);  // accepts connections and sends nothing
  ExpectOneLine(Check("--timeout 0.2 " + target), 1, target + " did not respond within 0.2 s");
  close(listener);
}

TEST(HealthCheckTest, OfAServerWithTls) {
  const TestFiles files;
  const TestAuthority authority("ours"), stranger("another");
  const TestCertificate elsewhere = authority.Issue({.common_name = "x", .alternative_names = "DNS:tracker.test"});
  const TestCertificate own = authority.Issue({.common_name = "lab"});
  const std::string ca = files.Write("ca", authority.pem()), other_ca = files.Write("other", stranger.pem());
  const std::string certificate = files.Write("own", own.certificate_pem), key = files.Write("key", own.key_pem);
  Program program({"--listen", "127.0.0.1:0", "--tls-cert", files.Write("crt", elsewhere.certificate_pem), "--tls-key",
                   files.Write("server.key", elsewhere.key_pem), "--tls-client-ca", ca});
  const std::string address = program.Announced("listening on ");
  const std::string shown = absl::StrCat("--tls-cert ", certificate, " --tls-key ", key, " ");

  ExpectHealthy(Check(absl::StrCat(shown, "--tls-ca ", ca, " --tls-name tracker.test ", address)));
  ExpectHealthy(Check(address, absl::StrCat("EVPOSE_HEALTH_TLS_CA=", ca, " EVPOSE_HEALTH_TLS_CERT=", certificate,
                                            " EVPOSE_HEALTH_TLS_KEY=", key, " EVPOSE_HEALTH_TLS_NAME=tracker.test")));
  const std::vector<std::string> refused = {
      absl::StrCat(shown, "--tls-ca ", ca, " ", address),                                 // another name
      absl::StrCat(shown, "--tls-ca ", other_ca, " --tls-name tracker.test ", address),   // another authority
      absl::StrCat("--tls-ca ", ca, " --tls-name tracker.test --timeout 30 ", address)};  // shows no certificate
  for (const std::string& arguments : refused) ExpectOneLine(Check(arguments), 1, "that the certificates are right");
  ExpectOneLine(Check(address), 1, "for a server with TLS give --tls-ca");
  ExpectOneLine(Check(absl::StrCat("--tls-ca ", key, " ", address)), 1, key);
  ExpectOneLine(Check("--tls-ca /no/such.crt " + address), 1, "/no/such.crt");
  ExpectOneLine(Check(absl::StrCat("--tls-cert ", ca, " --tls-key ", key, " ", address)), 1, key);
}

TEST(HealthCheckTest, WrongUsage) {
  ExpectOneLine(Check("nowhere"), 2, "has no port");
  ExpectOneLine(Check("127.0.0.1:0"), 2, "port 0 is not a server's port");
  ExpectOneLine(Check("--tls-cert c 127.0.0.1:1"), 2, "--tls-cert and --tls-key belong together");
  EXPECT_EQ(Check("--timeout 0 127.0.0.1:1").status, 2);
  ExpectOneLine(Check("--timeout nan 127.0.0.1:1"), 2, "--timeout: \"nan\" is not a number from 0.001 to 3600; ");
  EXPECT_EQ(Check("--no-such-option").status, 2);
  const Result help = Check("--help");
  EXPECT_EQ(help.status, 0);
  EXPECT_THAT(help.text, HasSubstr("evpose-health-check 127.0.0.1:50051"));
}

}  // namespace
}  // namespace evpose::server
