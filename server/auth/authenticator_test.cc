// SPDX-License-Identifier: Apache-2.0
#include "server/auth/authenticator.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
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
  EXPECT_EQ(authenticator->Authenticate({{"Bearer of nothing"}, "somebody"}).value(), (Caller{"", true}));
}

TEST(AuthenticatorTest, Tokens) {
  const TestFiles files;
  const NewToken lab = MakeToken("lab", false).value();
  const NewToken admin = MakeToken("admin", true).value();
  const std::string path = files.Write("tokens", absl::StrCat(lab.line, "\n", admin.line, "\n"));
  const auto authenticator = Authenticator::Create({path, true}).value();
  EXPECT_FALSE(authenticator->is_open());
  const auto ask = [&](const std::vector<absl::string_view>& authorization) {
    return Describe(authenticator->Authenticate({authorization, "certificate"}));
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
}

TEST(AuthenticatorTest, CertificatesWithoutTokens) {
  const auto authenticator = Authenticator::Create({"", true}).value();
  EXPECT_FALSE(authenticator->is_open());
  EXPECT_EQ(Describe(authenticator->Authenticate({{}, "capture-1"})), "capture-1");
  EXPECT_EQ(Describe(authenticator->Authenticate({{}, std::nullopt})), "UNAUTHENTICATED BAD_CERTIFICATE");
  EXPECT_EQ(Describe(authenticator->Authenticate({{}, ""})), "UNAUTHENTICATED BAD_CERTIFICATE");
  EXPECT_EQ(Describe(authenticator->Authenticate({{}, "John Doe"})), "UNAUTHENTICATED BAD_CERTIFICATE");
}

TEST(AuthenticatorTest, AFileThatCannotBeRead) {
  EXPECT_EQ(Authenticator::Create({"/no/such/file", false}).status().code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace evpose::server
