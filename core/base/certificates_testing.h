// SPDX-License-Identifier: Apache-2.0

// Authorities and certificates made by the tests themselves.
#pragma once

#include <gtest/gtest.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509v3.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/time/clock.h"
#include "absl/time/time.h"

namespace evpose {

struct TestCertificate {
  std::string certificate_pem;
  std::string key_pem;
};

struct TestCertificateOptions {
  std::string common_name = "localhost";
  std::string second_common_name;                                // empty: none
  std::string alternative_names = "DNS:localhost,IP:127.0.0.1";  // empty: no extension
  absl::Time not_before = absl::Now() - absl::Hours(1);
  absl::Time not_after = absl::Now() + absl::Hours(24);
};

// An authority with a key of its own; every certificate has another key.
class TestAuthority {
 public:
  explicit TestAuthority(const std::string& name = "test authority")
      : key_(NewKey()), certificate_(X509_new(), X509_free) {
    TestCertificateOptions options;
    options.common_name = name;
    Fill(*certificate_, options, *key_);
    X509_set_issuer_name(certificate_.get(), X509_get_subject_name(certificate_.get()));
    Extend(*certificate_, NID_basic_constraints, "critical,CA:TRUE");
    EXPECT_GT(X509_sign(certificate_.get(), key_.get(), EVP_sha256()), 0);
  }

  std::string pem() const { return ToPem(*certificate_); }

  TestCertificate Issue(const TestCertificateOptions& options = {}) const {
    const Key key = NewKey();
    const X509Pointer certificate(X509_new(), X509_free);
    Fill(*certificate, options, *key);
    X509_set_issuer_name(certificate.get(), X509_get_subject_name(certificate_.get()));
    if (!options.alternative_names.empty()) {
      Extend(*certificate, NID_subject_alt_name, options.alternative_names.c_str());
    }
    EXPECT_GT(X509_sign(certificate.get(), key_.get(), EVP_sha256()), 0);
    return {ToPem(*certificate), ToPem(*key)};
  }

  // A list that revokes these certificates.
  std::string Revoke(const std::vector<TestCertificate>& certificates) const {
    const std::unique_ptr<X509_CRL, void (*)(X509_CRL*)> list(X509_CRL_new(), X509_CRL_free);
    X509_CRL_set_version(list.get(), X509_CRL_VERSION_2);
    X509_CRL_set_issuer_name(list.get(), X509_get_subject_name(certificate_.get()));
    const std::unique_ptr<ASN1_TIME, void (*)(ASN1_TIME*)> now(ASN1_TIME_set(nullptr, absl::ToTimeT(absl::Now())),
                                                               ASN1_TIME_free);
    X509_CRL_set1_lastUpdate(list.get(), now.get());
    for (const TestCertificate& certificate : certificates) {
      const BioPointer in(BIO_new_mem_buf(certificate.certificate_pem.data(), -1), BIO_free);
      const X509Pointer x509(PEM_read_bio_X509(in.get(), nullptr, nullptr, nullptr), X509_free);
      X509_REVOKED* const revoked = X509_REVOKED_new();
      X509_REVOKED_set_serialNumber(revoked, X509_get_serialNumber(x509.get()));
      X509_REVOKED_set_revocationDate(revoked, now.get());
      X509_CRL_add0_revoked(list.get(), revoked);
    }
    X509_CRL_sort(list.get());
    EXPECT_GT(X509_CRL_sign(list.get(), key_.get(), EVP_sha256()), 0);
    return Written([&](BIO* bio) { return PEM_write_bio_X509_CRL(bio, list.get()); });
  }

  // The key of `certificate` in PEM, encrypted with a passphrase.
  static std::string Encrypted(const TestCertificate& certificate) {
    const BioPointer in(BIO_new_mem_buf(certificate.key_pem.data(), static_cast<int>(certificate.key_pem.size())),
                        BIO_free);
    const Key key(PEM_read_bio_PrivateKey(in.get(), nullptr, nullptr, nullptr), EVP_PKEY_free);
    char passphrase[] = "passphrase";
    return Written([&](BIO* bio) {
      return PEM_write_bio_PKCS8PrivateKey(bio, key.get(), EVP_aes_128_cbc(), passphrase, sizeof(passphrase) - 1,
                                           nullptr, nullptr);
    });
  }

 private:
  using Key = std::unique_ptr<EVP_PKEY, void (*)(EVP_PKEY*)>;
  using X509Pointer = std::unique_ptr<X509, void (*)(X509*)>;
  using BioPointer = std::unique_ptr<BIO, int (*)(BIO*)>;

  static Key NewKey() { return {EVP_EC_gen("P-256"), EVP_PKEY_free}; }

  static void Fill(X509& certificate, const TestCertificateOptions& options, EVP_PKEY& key) {
    static long serial = 0;
    X509_set_version(&certificate, X509_VERSION_3);
    ASN1_INTEGER_set(X509_get_serialNumber(&certificate), ++serial);
    ASN1_TIME_set(X509_getm_notBefore(&certificate), absl::ToTimeT(options.not_before));
    ASN1_TIME_set(X509_getm_notAfter(&certificate), absl::ToTimeT(options.not_after));
    X509_set_pubkey(&certificate, &key);
    X509_NAME_add_entry_by_txt(X509_get_subject_name(&certificate), "CN", MBSTRING_UTF8,
                               reinterpret_cast<const unsigned char*>(options.common_name.c_str()), -1, -1, 0);
    if (options.second_common_name.empty()) return;
    X509_NAME_add_entry_by_txt(X509_get_subject_name(&certificate), "CN", MBSTRING_UTF8,
                               reinterpret_cast<const unsigned char*>(options.second_common_name.c_str()), -1, -1, 0);
  }

  static void Extend(X509& certificate, int nid, const char* value) {
    X509V3_CTX context;
    X509V3_set_ctx_nodb(&context);
    X509V3_set_ctx(&context, &certificate, &certificate, nullptr, nullptr, 0);
    X509_EXTENSION* extension = X509V3_EXT_conf_nid(nullptr, &context, nid, value);
    ASSERT_NE(extension, nullptr) << value;
    X509_add_ext(&certificate, extension, -1);
    X509_EXTENSION_free(extension);
  }

  template <typename Write>
  static std::string Written(const Write& write) {
    const BioPointer bio(BIO_new(BIO_s_mem()), BIO_free);
    EXPECT_EQ(write(bio.get()), 1);
    char* data = nullptr;
    const long size = BIO_get_mem_data(bio.get(), &data);
    return {data, static_cast<size_t>(size)};
  }
  static std::string ToPem(X509& certificate) {
    return Written([&](BIO* bio) { return PEM_write_bio_X509(bio, &certificate); });
  }
  static std::string ToPem(EVP_PKEY& key) {
    return Written(
        [&](BIO* bio) { return PEM_write_bio_PrivateKey(bio, &key, nullptr, nullptr, 0, nullptr, nullptr); });
  }

  Key key_;
  X509Pointer certificate_;
};

}  // namespace evpose
