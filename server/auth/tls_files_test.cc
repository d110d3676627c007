// SPDX-License-Identifier: Apache-2.0
#include "server/auth/tls_files.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <chrono>
#include <filesystem>

#include "core/base/certificates_testing.h"
#include "server/auth/files_testing.h"

namespace evpose::server {
namespace {

using ::testing::HasSubstr;

class TlsFilesTest : public testing::Test {
 protected:
  void Write(const TestCertificate& certificate) {
    paths_.certificate = files_.Write("server.crt", certificate.certificate_pem);
    paths_.key = files_.Write("server.key", certificate.key_pem);
  }
  std::string OpenError() { return std::string(TlsFiles::Open(paths_).status().message()); }

  const TestFiles files_;
  const TestAuthority authority_;
  TlsPaths paths_;
};

TEST_F(TlsFilesTest, MissingFilesAreErrors) {
  EXPECT_TRUE(TlsPaths({"", "", ""}).Validate().ok());
  EXPECT_THAT(std::string(TlsPaths({"c", "", ""}).Validate().message()), HasSubstr("--tls-cert needs --tls-key"));
  EXPECT_THAT(std::string(TlsPaths({"", "k", ""}).Validate().message()), HasSubstr("--tls-key needs --tls-cert"));
  EXPECT_THAT(std::string(TlsPaths({"", "", "a"}).Validate().message()), HasSubstr("--tls-client-ca needs"));
  EXPECT_THAT(std::string(TlsPaths({"c", "k", "", "r"}).Validate().message()), HasSubstr("--tls-client-crl needs"));
}

TEST_F(TlsFilesTest, MistakesNameTheFile) {
  Write(authority_.Issue());
  paths_.client_ca = files_.Path("none.crt");
  EXPECT_THAT(OpenError(), HasSubstr("none.crt"));
  paths_.client_ca = paths_.key;
  EXPECT_THAT(OpenError(), HasSubstr("server.key has no certificate in it"));
  paths_.client_ca = "";
  files_.Write("server.key", authority_.Issue().key_pem);
  EXPECT_THAT(OpenError(), HasSubstr("server.key is not the key of"));
  Write(authority_.Issue({.not_after = absl::Now() - absl::Minutes(1)}));
  EXPECT_THAT(OpenError(), HasSubstr("server.crt expired on"));
}

TEST_F(TlsFilesTest, NewFilesAreTakenWhenTheyBelongTogether) {
  const TestCertificate old_pair = authority_.Issue();
  Write(old_pair);
  const auto files = TlsFiles::Open(paths_).value();
  const auto old_material = files->Current();
  EXPECT_EQ(old_material->certificate_pem, old_pair.certificate_pem);
  EXPECT_EQ(files->Current(), old_material);

  const TestCertificate new_pair = authority_.Issue();
  files_.Write("server.crt", new_pair.certificate_pem);
  EXPECT_EQ(files->Current(), old_material) << "the key file is still the previous one";
  files_.Write("server.key", new_pair.key_pem);
  EXPECT_EQ(files->Current()->certificate_pem, new_pair.certificate_pem);
  EXPECT_EQ(files->Current()->key_pem, new_pair.key_pem);
}

TEST_F(TlsFilesTest, AfterAnErrorOfReadingTheFilesAreReadAgain) {
  Write(authority_.Issue());
  std::chrono::steady_clock::time_point now;
  const auto files = TlsFiles::Open(paths_, [&now] { return now; }).value();
  const auto material = files->Current();
  const TestCertificate new_pair = authority_.Issue();
  Write(new_pair);
  rlimit limit;
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &limit), 0);
  rlimit no_files = limit;
  no_files.rlim_cur = 0;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &no_files), 0);
  EXPECT_EQ(files->Current(), material);
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &limit), 0);
  now += std::chrono::seconds(1);
  EXPECT_EQ(files->Current()->certificate_pem, new_pair.certificate_pem);
}

TEST_F(TlsFilesTest, DamagedNewFilesAreRefused) {
  Write(authority_.Issue());
  paths_.client_ca = files_.Write("ca.crt", authority_.pem());
  const auto files = TlsFiles::Open(paths_).value();
  const auto material = files->Current();
  EXPECT_EQ(material->client_ca_pem, authority_.pem());
  files_.Write("ca.crt", "nothing");
  EXPECT_EQ(files->Current(), material);
  std::filesystem::remove(paths_.client_ca);
  EXPECT_EQ(files->Current(), material);
  files_.Write("ca.crt", TestAuthority("another").pem());
  EXPECT_NE(files->Current()->client_ca_pem, authority_.pem());
}

}  // namespace
}  // namespace evpose::server
