// SPDX-License-Identifier: Apache-2.0

// TLS and tokens from the client's side.
#include <gmock/gmock.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>
#include <openssl/pem.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "client/lib/fake_clock_testing.h"
#include "client/lib/server_address.h"
#include "client/lib/stream/scripted_server_testing.h"
#include "client/lib/tls_probe.h"
#include "core/base/certificates_testing.h"
#include "evpose/client.h"
#include "evpose/v1/admin_service.grpc.pb.h"

namespace evpose::client {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class FakeAdmin final : public v1::AdminService::Service {
 public:
  grpc::Status GetServerInfo(grpc::ServerContext* context, const v1::GetServerInfoRequest*, v1::ServerInfo*) override {
    const auto found = context->client_metadata().find("authorization");
    authorization =
        found == context->client_metadata().end() ? "" : std::string(found->second.data(), found->second.size());
    return grpc::Status::OK;
  }
  std::string authorization;
};

class SecurityTest : public ::testing::Test {
 protected:
  SecurityTest()
      : directory_(std::filesystem::path(::testing::TempDir()) / ("evpose_security." + std::to_string(getpid()))) {
    std::filesystem::create_directories(directory_);
    options_.connect_timeout = absl::Seconds(20);  // long enough for a slow machine; no case waits for it
    options_.tls.is_on = true;
    options_.tls.ca_file = Write("ca.crt", authority_.pem());
  }
  ~SecurityTest() override { std::filesystem::remove_all(directory_); }

  std::string Write(const std::string& name, const std::string& contents) const {
    const std::string path = (directory_ / name).string();
    std::ofstream(path) << contents;
    return path;
  }
  void Start(const std::shared_ptr<grpc::ServerCredentials>& credentials) {
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", credentials, &port_);
    builder.RegisterService(&admin_);
    builder.RegisterService(&sessions_);
    server_ = builder.BuildAndStart();
    ASSERT_GT(port_, 0);
  }
  void StartTls(const TestCertificate& certificate, const std::string& client_ca_pem = "") {
    grpc::SslServerCredentialsOptions options(client_ca_pem.empty()
                                                  ? GRPC_SSL_DONT_REQUEST_CLIENT_CERTIFICATE
                                                  : GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
    options.pem_key_cert_pairs.push_back({certificate.key_pem, certificate.certificate_pem});
    options.pem_root_certs = client_ca_pem;
    Start(grpc::SslServerCredentials(options));
  }
  void Show(const TestCertificate& certificate) {
    options_.tls.certificate_file = Write("client.crt", certificate.certificate_pem);
    options_.tls.key_file = Write("client.key", certificate.key_pem);
  }
  // Returns "OK" or the error message.
  std::string Connect(const std::string& host = "127.0.0.1") {
    const auto client = Client::Connect(host + ":" + std::to_string(port_), options_);
    return client.ok() ? "OK" : std::string(client.status().message());
  }

  const std::filesystem::path directory_;
  const TestAuthority authority_;
  FakeAdmin admin_;
  ScriptedService sessions_;
  std::unique_ptr<grpc::Server> server_;
  int port_ = 0;
  ClientOptions options_;
};

TEST_F(SecurityTest, ATokenGoesWithEveryCall) {
  StartTls(authority_.Issue());
  options_.token = "evpose_secret";
  EXPECT_EQ(Connect(), "OK");
  EXPECT_EQ(admin_.authorization, "Bearer evpose_secret");
  EXPECT_EQ(Connect("localhost"), "OK");
  options_.token = "";
  EXPECT_EQ(Connect(), "OK");
  EXPECT_EQ(admin_.authorization, "");
}

TEST_F(SecurityTest, ATokenIsRenewedBeforeEveryCall) {
  Start(grpc::InsecureServerCredentials());
  options_.tls = {};
  options_.token = "evpose_first";
  absl::StatusOr<std::string> now = std::string("evpose_second");
  options_.renew_token = [&now] { return now; };
  const auto client = Client::Connect("127.0.0.1:" + std::to_string(port_), options_);
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_EQ(admin_.authorization, "Bearer evpose_second");
  now = std::string("evpose_third");
  EXPECT_TRUE((*client)->GetServerInfo().ok());
  EXPECT_EQ(admin_.authorization, "Bearer evpose_third");
  for (const absl::StatusOr<std::string>& none :
       {absl::StatusOr<std::string>(absl::NotFoundError("gone")), absl::StatusOr<std::string>(""),
        absl::StatusOr<std::string>("two words")}) {
    now = none;
    EXPECT_TRUE((*client)->GetServerInfo().ok());
    EXPECT_EQ(admin_.authorization, "Bearer evpose_third");
  }
}

TEST_F(SecurityTest, ATokenMayBeKnownByRenewTokenAlone) {
  Start(grpc::InsecureServerCredentials());
  options_.tls = {};
  absl::StatusOr<std::string> now = std::string("evpose_only");
  options_.renew_token = [&now] { return now; };
  EXPECT_EQ(Connect(), "OK");
  EXPECT_EQ(admin_.authorization, "Bearer evpose_only");
  EXPECT_THAT(Client::Connect("192.0.2.1:50051", options_).status().message(), HasSubstr("in clear"));
  now = std::string("two words");
  EXPECT_THAT(Connect(), HasSubstr("token: has spaces"));
  now = absl::NotFoundError("token.txt: is gone");
  EXPECT_EQ(Connect(), "token.txt: is gone");
  now = std::string();
  EXPECT_EQ(Connect(), "OK");
  EXPECT_EQ(admin_.authorization, "");
}

TEST_F(SecurityTest, AStreamContinuesOnceWithATokenThatWasReplaced) {
  Start(grpc::InsecureServerCredentials());
  std::atomic<int> version = 1, num_streams = 0;
  sessions_.script = [&](ServerStream& stream) {
    v1::TrackRequest request;
    stream.Read(&request);
    stream.Write(Attached(1000));
    if (++num_streams == 2) {
      ReadToEnd(stream);
      stream.Write(SummaryMessage(0));
      return grpc::Status::OK;
    }
    stream.Read(&request);
    version = 2;
    return grpc::Status(grpc::StatusCode::UNAUTHENTICATED, "withdrawn");
  };
  options_.tls = {};
  options_.token = "evpose_1";
  options_.renew_token = [&version] { return "evpose_" + std::to_string(version.load()); };
  const auto client = Client::Connect("127.0.0.1:" + std::to_string(port_), options_);
  ASSERT_TRUE(client.ok()) << client.status();
  const auto track = [&client] {
    FakeClock clock;
    TrackOptions options;
    options.clock = &clock;
    const ChunkSource source = [num_left = 2]() mutable -> absl::StatusOr<EventChunk> {
      return EventChunk{.bytes = std::vector<uint8_t>(--num_left > 0 ? 8 : 0)};
    };
    return (*client)->Track(Session{.name = "sessions/1"}, source, {}, options).status();
  };
  const absl::Status status = track();
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_EQ(num_streams, 2);
  EXPECT_EQ(track().code(), absl::StatusCode::kUnauthenticated);
  EXPECT_EQ(num_streams, 3) << "the token was the same";
}

TEST_F(SecurityTest, AnUnencryptedTokenIsSentToLoopbackAddressesOnly) {
  Start(grpc::InsecureServerCredentials());
  options_.tls = {};
  options_.token = "evpose_secret";
  EXPECT_EQ(Connect(), "OK");
  EXPECT_EQ(admin_.authorization, "Bearer evpose_secret");
  const auto elsewhere = Client::Connect("192.0.2.1:50051", options_);
  EXPECT_EQ(elsewhere.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(elsewhere.status().message()), AllOf(HasSubstr("in clear"), HasSubstr("--tls")));
}

TEST_F(SecurityTest, LoopbackAddresses) {
  for (const char* address : {"localhost:1", "127.0.0.1:1", "127.1.2.3:1", "[::1]:1"}) {
    EXPECT_TRUE(ParseServerAddress(address)->IsLoopback()) << address;
  }
  for (const char* address : {"localhost.example:1", "128.0.0.1:1", "127.0.0.1.example:1", "[::2]:1", "0.0.0.0:1"}) {
    EXPECT_FALSE(ParseServerAddress(address)->IsLoopback()) << address;
  }
}

TEST_F(SecurityTest, CertificatesThatAreRefusedAreExplained) {
  StartTls(authority_.Issue({.alternative_names = "DNS:pose.example,IP:10.0.0.1"}));
  EXPECT_THAT(Connect(), HasSubstr("its certificate is not for 127.0.0.1 but for pose.example, 10.0.0.1"));
  StartTls(authority_.Issue({.not_after = absl::Now() - absl::Minutes(1)}));
  EXPECT_THAT(Connect(), HasSubstr("its certificate has expired"));
  StartTls(authority_.Issue({.not_before = absl::Now() + absl::Hours(1)}));
  EXPECT_THAT(Connect(), HasSubstr("its certificate is not valid yet"));
  StartTls(TestAuthority().Issue());
  EXPECT_THAT(Connect(), AllOf(HasSubstr("authority that this machine does not trust"), HasSubstr("--tls-ca")));
  options_.tls.ca_file = "";
  EXPECT_THAT(Connect(), HasSubstr("authority that this machine does not trust")) << "the system's authorities";
}

TEST_F(SecurityTest, HostsOfAMaliciousCertificateAreEscaped) {
  const auto hosts_of = [this](const std::string& names) {
    const std::string pem = authority_.Issue({.alternative_names = names}).certificate_pem;
    const std::unique_ptr<BIO, decltype(&BIO_free)> in(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())),
                                                       BIO_free);
    const std::unique_ptr<X509, decltype(&X509_free)> certificate(
        PEM_read_bio_X509(in.get(), nullptr, nullptr, nullptr), X509_free);
    return HostsOf(certificate.get());
  };
  EXPECT_EQ(hosts_of("DNS:pose.example,IP:10.0.0.1,IP:::1,email:a@b"), "pose.example, 10.0.0.1, ::1");
  EXPECT_EQ(hosts_of(""), "no host");
  // An address of one byte, an empty address, and a name with an escape sequence for terminals.
  EXPECT_EQ(hosts_of("DER:30:0b:87:01:7f:87:00:82:04:1b:5b:31:6d"), "\\x1b[1m");
}

TEST_F(SecurityTest, OneSideWithoutTls) {
  Start(grpc::InsecureServerCredentials());
  EXPECT_THAT(Connect(), HasSubstr("it does not use TLS"));
  StartTls(authority_.Issue());
  options_.tls = {};
  EXPECT_THAT(Connect(), AllOf(HasSubstr("it requires TLS"), HasSubstr("--tls-ca")));
}

TEST_F(SecurityTest, ServersThatAskForACertificate) {
  const TestAuthority clients("clients");
  StartTls(authority_.Issue(), clients.pem());
  EXPECT_THAT(Connect(), HasSubstr("it requires a certificate from its clients: give --tls-cert"));
  Show(clients.Issue({.common_name = "lab"}));
  EXPECT_EQ(Connect(), "OK");
  Show(authority_.Issue({.common_name = "lab"}));
  EXPECT_THAT(Connect(), AllOf(HasSubstr("it rejects the certificate"), HasSubstr("client.crt")));
}

TEST_F(SecurityTest, FilesThatCannotBeUsed) {
  options_.tls.ca_file = Write("ca.crt", "nothing");
  EXPECT_THAT(Connect("localhost"), HasSubstr("HOST:PORT")) << "the address is tried first";
  port_ = 1;
  EXPECT_THAT(Connect(), HasSubstr("ca.crt has no certificate in it"));
  options_.tls.ca_file = (directory_ / "none.crt").string();
  EXPECT_THAT(Connect(), HasSubstr("none.crt"));
  options_.tls.ca_file = "";
  Show(authority_.Issue({.not_after = absl::Now() - absl::Minutes(1)}));
  EXPECT_THAT(Connect(), HasSubstr("client.crt expired on"));
  options_.tls.key_file = "";
  EXPECT_THAT(Connect(), HasSubstr("a certificate needs its key"));
  options_.tls = {};
  options_.token = "two words";
  EXPECT_THAT(Connect(), AllOf(HasSubstr("token: has spaces"), testing::Not(HasSubstr("words"))));
}

}  // namespace
}  // namespace evpose::client
