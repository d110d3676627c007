// SPDX-License-Identifier: Apache-2.0
#include "server/auth/authenticator.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>

#include "absl/strings/str_cat.h"
#include "core/base/certificates_testing.h"
#include "server/auth/files_testing.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

// Returns the tenant, or code and reason of the error.
std::string Describe(const absl::StatusOr<Caller>& caller) {
  if (caller.ok()) return absl::StrCat(caller->tenant, caller->is_operator ? " operator" : "");
  return absl::StrCat(absl::StatusCodeToString(caller.status().code()), " ", GetErrorDetails(caller.status()).reason);
}

TEST(AuthenticatorTest, WithoutTokensAndCertificatesEverybodyMayCall) {
  const auto authenticator = Authenticator::Create({}).value();
  EXPECT_TRUE(authenticator->is_open());
  EXPECT_EQ(authenticator->Authenticate({}).value(), (Caller{"", true}));
  EXPECT_EQ(authenticator->Authenticate({{"Bearer of nothing"}, "certificate", "peer"}).value(),
            (Caller{"", true, "peer"}));
  EXPECT_EQ(authenticator->num_tokens(), std::nullopt);
}

TEST(AuthenticatorTest, Tokens) {
  const TestFiles files;
  const NewToken lab = MakeToken("lab", false).value();
  const NewToken admin = MakeToken("admin", true).value();
  const std::string path = files.Write("tokens", absl::StrCat(lab.line, "\n", admin.line, "\n"));
  const auto metrics = std::make_shared<ServerMetrics>();
  const auto authenticator =
      Authenticator::Create({.token_file = path, .has_client_certificates = true, .metrics = metrics}).value();
  EXPECT_FALSE(authenticator->is_open());
  EXPECT_EQ(authenticator->num_tokens(), 2u);
  const auto ask = [&](const std::vector<absl::string_view>& authorization) {
    return Describe(authenticator->Authenticate({authorization, "", "peer"}));
  };
  const std::string good = "Bearer " + lab.token;
  EXPECT_EQ(ask({good}), "lab");
  EXPECT_EQ(ask({"bearer " + admin.token}), "admin operator");
  EXPECT_EQ(ask({}), "UNAUTHENTICATED NO_TOKEN");
  EXPECT_EQ(ask({""}), "UNAUTHENTICATED BAD_TOKEN");
  EXPECT_EQ(ask({lab.token}), "UNAUTHENTICATED BAD_TOKEN");
  EXPECT_EQ(ask({"Basic " + lab.token}), "UNAUTHENTICATED BAD_TOKEN");
  EXPECT_EQ(ask({good + "0"}), "UNAUTHENTICATED BAD_TOKEN");
  EXPECT_EQ(ask({good.substr(0, good.size() - 1)}), "UNAUTHENTICATED BAD_TOKEN");
  EXPECT_EQ(ask({good, good}), "UNAUTHENTICATED BAD_TOKEN");
  EXPECT_EQ(metrics->authentication_failures[AuthenticationFailure::kNoToken].value(), 1u);
  EXPECT_EQ(metrics->authentication_failures[AuthenticationFailure::kBadToken].value(), 6u);

  const uint64_t version = authenticator->version();
  EXPECT_EQ(authenticator->BeginCheck().version, version);
  files.Write("tokens", "");
  EXPECT_GT(authenticator->version(), version);
  EXPECT_EQ(ask({good}), "UNAUTHENTICATED BAD_TOKEN");
}

class CertificatesTest : public testing::Test {
 protected:
  std::unique_ptr<Authenticator> Make(const std::string& revocations = "") {
    return Authenticator::Create({.has_client_certificates = true,
                                  .revocations = revocations,
                                  .metrics = metrics_,
                                  .now = [this] { return now_; }})
        .value();
  }
  TestCertificate Issue(const std::string& name) const { return authority_.Issue({.common_name = name}); }
  static std::string Ask(Authenticator& authenticator, const TestCertificate& certificate) {
    return Describe(authenticator.Authenticate({{}, certificate.certificate_pem, "peer"}));
  }

  const TestFiles files_;
  const TestAuthority authority_;
  const std::shared_ptr<ServerMetrics> metrics_ = std::make_shared<ServerMetrics>();
  absl::Time now_ = absl::Now();
};

constexpr char kBadCertificate[] = "UNAUTHENTICATED BAD_CERTIFICATE";

TEST_F(CertificatesTest, TheOnlyCommonNameIsTheTenant) {
  const auto authenticator = Make();
  EXPECT_FALSE(authenticator->is_open());
  EXPECT_EQ(Ask(*authenticator, Issue("capture-1")), "capture-1");
  EXPECT_EQ(Ask(*authenticator, Issue("John Doe")), kBadCertificate);
  EXPECT_EQ(Ask(*authenticator, authority_.Issue({.common_name = "lab", .second_common_name = "field"})),
            kBadCertificate);
  EXPECT_EQ(Ask(*authenticator, {}), kBadCertificate) << "no certificate";
  EXPECT_EQ(Ask(*authenticator, {"nonsense", ""}), kBadCertificate);
  EXPECT_EQ(metrics_->authentication_failures[AuthenticationFailure::kBadCertificate].value(), 4u);
}

TEST_F(CertificatesTest, ACertificateThatExpiresOnAnOpenConnection) {
  const auto authenticator = Make();
  const TestCertificate certificate = authority_.Issue({.common_name = "lab", .not_after = now_ + absl::Hours(2)});
  const auto caller = authenticator->Authenticate({{}, certificate.certificate_pem, "peer"});
  ASSERT_TRUE(caller.ok()) << caller.status();
  EXPECT_LE(caller->expires, now_ + absl::Hours(2));
  EXPECT_GT(caller->expires, now_ + absl::Hours(2) - absl::Seconds(2));
  now_ = caller->expires;
  EXPECT_EQ(Ask(*authenticator, certificate), kBadCertificate);
}

TEST_F(CertificatesTest, RevokedCertificatesAreRejected) {
  const TestCertificate lost = Issue("lab");
  const TestCertificate kept = Issue("lab");
  const TestAuthority other("another authority");
  const auto authenticator = Make(files_.Write("crl", authority_.Revoke({})));
  const uint64_t version = authenticator->version();
  EXPECT_EQ(Ask(*authenticator, lost), "lab");
  files_.Write("crl", other.Revoke({lost}));
  EXPECT_EQ(Ask(*authenticator, lost), "lab") << "the serial number of another authority";
  files_.Write("crl", other.Revoke({}) + authority_.Revoke({lost}));
  EXPECT_EQ(Ask(*authenticator, lost), kBadCertificate);
  EXPECT_EQ(Ask(*authenticator, kept), "lab");
  EXPECT_EQ(authenticator->version(), version + 2);
}

TEST_F(CertificatesTest, WithATokenTheCertificateIsCheckedToo) {
  const NewToken lab = MakeToken("lab", false).value();
  const TestCertificate lost = Issue("anybody at all");
  const std::string crl = files_.Write("crl", authority_.Revoke({lost}));
  const auto authenticator =
      Authenticator::Create(
          {.token_file = files_.Write("tokens", lab.line), .has_client_certificates = true, .revocations = crl})
          .value();
  const std::string token = "Bearer " + lab.token;
  EXPECT_EQ(Describe(authenticator->Authenticate({{token}, lost.certificate_pem, "peer"})), kBadCertificate);
  EXPECT_EQ(Describe(authenticator->Authenticate({{token}, Issue("anybody else").certificate_pem, "peer"})), "lab");
}

TEST_F(CertificatesTest, RevocationListsThatCannotBeRead) {
  const auto error = [this](const std::string& contents) {
    return std::string(OpenRevocationFile(files_.Write("crl", contents)).status().message());
  };
  EXPECT_THAT(error(authority_.pem()), testing::HasSubstr("crl has no revocation list in it"));
  const std::string list = authority_.Revoke({Issue("lab")});
  EXPECT_THAT(error(list + list.substr(0, list.size() / 2)), testing::HasSubstr("damaged after revocation list 1"));
  EXPECT_EQ(OpenRevocationFile(files_.Path("none")).status().code(), absl::StatusCode::kNotFound);
}

TEST(AuthenticatorTest, AFileThatCannotBeRead) {
  EXPECT_EQ(Authenticator::Create({.token_file = "/no/such/file"}).status().code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace evpose::server
