// SPDX-License-Identifier: Apache-2.0
#include "core/base/certificates.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include "core/base/certificates_testing.h"
#include "core/base/temporary_directory_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

std::string Message(const absl::Status& status) { return std::string(status.message()); }

TEST(CertificatesTest, AGoodPairWithItsChain) {
  const TestAuthority authority;
  const TestCertificate issued = authority.Issue();
  const PemFile key = {"server.key", issued.key_pem};
  EXPECT_TRUE(CheckKeyPair({"server.crt", issued.certificate_pem}, key, absl::Now()).ok());
  EXPECT_TRUE(CheckKeyPair({"server.crt", issued.certificate_pem + authority.pem()}, key, absl::Now()).ok());
  EXPECT_TRUE(CheckAuthorities({"ca.crt", "# ours\n" + authority.pem() + authority.pem()}).ok());
}

TEST(CertificatesTest, FilesThatAreNotPem) {
  const TestAuthority authority;
  const TestCertificate issued = authority.Issue();
  const PemFile certificate = {"server.crt", issued.certificate_pem};
  const PemFile key = {"server.key", issued.key_pem};
  EXPECT_THAT(Message(CheckAuthorities({"ca.crt", ""})), HasSubstr("ca.crt has no certificate in it"));
  EXPECT_THAT(Message(CheckAuthorities({"ca.crt", issued.key_pem})), HasSubstr("ca.crt has no certificate in it"));
  const std::string damaged = authority.pem() + authority.pem().substr(0, authority.pem().size() / 2);
  EXPECT_THAT(Message(CheckAuthorities({"ca.crt", damaged})), HasSubstr("ca.crt is damaged after certificate 1"));
  EXPECT_THAT(Message(CheckKeyPair(key, key, absl::Now())), HasSubstr("server.key has no certificate in it"));
  EXPECT_THAT(Message(CheckKeyPair(certificate, {"server.key", "nonsense"}, absl::Now())),
              HasSubstr("server.key has no private key in it"));
  EXPECT_THAT(Message(CheckKeyPair(certificate, {"server.key", TestAuthority::Encrypted(issued)}, absl::Now())),
              HasSubstr("server.key is encrypted"));
}

TEST(CertificatesTest, TheFilesOfAClient) {
  const TemporaryDirectory directory;
  const TestAuthority authority;
  const TestCertificate issued = authority.Issue();
  const auto write = [&directory](const std::string& name, const std::string& contents) {
    const std::string path = directory.path() + "/" + name;
    std::ofstream(path) << contents;
    return path;
  };
  const std::string ca = write("ca.crt", authority.pem());
  const std::string certificate = write("client.crt", issued.certificate_pem);
  const std::string key = write("client.key", issued.key_pem);
  const auto all = ReadClientPem(ca, certificate, key, absl::Now());
  ASSERT_TRUE(all.ok()) << all.status();
  EXPECT_EQ(all->authorities, authority.pem());
  EXPECT_EQ(all->certificate, issued.certificate_pem);
  EXPECT_EQ(all->key, issued.key_pem);
  const auto none = ReadClientPem("", "", "", absl::Now());
  ASSERT_TRUE(none.ok()) << none.status();
  EXPECT_EQ(none->authorities + none->certificate + none->key, "");
  EXPECT_THAT(Message(ReadClientPem(key, "", "", absl::Now()).status()), HasSubstr("client.key has no certificate"));
  EXPECT_THAT(Message(ReadClientPem(ca, certificate, ca, absl::Now()).status()),
              HasSubstr("ca.crt has no private key"));
}

TEST(CertificatesTest, KeyOfAnotherCertificate) {
  const TestAuthority authority;
  const PemFile certificate = {"server.crt", authority.Issue().certificate_pem};
  const absl::Status status = CheckKeyPair(certificate, {"server.key", authority.Issue().key_pem}, absl::Now());
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(Message(status), HasSubstr("server.key is not the key of server.crt"));
}

TEST(CertificatesTest, CertificateThatIsNotValidNow) {
  const TestCertificateOptions options;
  const TestCertificate issued = TestAuthority().Issue(options);
  const PemFile certificate = {"server.crt", issued.certificate_pem};
  const PemFile key = {"server.key", issued.key_pem};
  EXPECT_TRUE(CheckKeyPair(certificate, key, options.not_after - absl::Seconds(2)).ok());
  const absl::Status expired = CheckKeyPair(certificate, key, options.not_after + absl::Seconds(2));
  EXPECT_EQ(expired.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(Message(expired), HasSubstr("server.crt expired on 20"));
  EXPECT_THAT(Message(CheckKeyPair(certificate, key, options.not_before - absl::Seconds(2))),
              HasSubstr("server.crt is not valid before 20"));
}

}  // namespace
}  // namespace evpose
