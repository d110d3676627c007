// SPDX-License-Identifier: Apache-2.0
#include "core/base/certificates.h"

#include <openssl/asn1.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509.h>

#include <algorithm>
#include <ctime>
#include <memory>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

struct Free {
  void operator()(BIO* bio) const { BIO_free(bio); }
  void operator()(X509* certificate) const { X509_free(certificate); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
  void operator()(X509_CRL* list) const { X509_CRL_free(list); }
};
template <typename T>
using Owned = std::unique_ptr<T, Free>;

// A callback that refuses: without one OpenSSL would ask for the passphrase on the terminal.
int NoPassphrase(char*, int, int, void*) { return -1; }

absl::Status Invalid(const PemFile& file, absl::string_view why) {
  ERR_clear_error();
  return absl::InvalidArgumentError(absl::StrCat(file.path, " ", why));
}

Owned<BIO> Open(const PemFile& file) {
  return Owned<BIO>(BIO_new_mem_buf(file.contents.data(), static_cast<int>(file.contents.size())));
}

Owned<X509> ReadCertificate(BIO* bio) { return Owned<X509>(PEM_read_bio_X509(bio, nullptr, NoPassphrase, nullptr)); }

// Requires at least one certificate, and no incomplete one after the last.
absl::Status CheckChain(const PemFile& file) {
  const Owned<BIO> bio = Open(file);
  int num_certificates = 0;
  while (ReadCertificate(bio.get()) != nullptr) ++num_certificates;
  const bool is_at_end = ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
  ERR_clear_error();
  if (num_certificates > 0 && is_at_end) return absl::OkStatus();
  if (num_certificates > 0) return Invalid(file, absl::StrCat("is damaged after certificate ", num_certificates));
  return Invalid(file, "has no certificate in it; PEM is expected (-----BEGIN CERTIFICATE-----)");
}

absl::Time ToTime(const ASN1_TIME* time) {
  std::tm fields = {};
  if (ASN1_TIME_to_tm(time, &fields) != 1) return absl::InfinitePast();
  return absl::FromTimeT(timegm(&fields));
}

// Issuer and serial number. The issuer is represented by OpenSSL's hash of its canonical form, because a list may
// encode a name in another way than the certificate.
std::string KeyOf(const X509_NAME* issuer, const ASN1_INTEGER* serial) {
  int is_hashed = 0;
  const unsigned long hash = X509_NAME_hash_ex(issuer, nullptr, nullptr, &is_hashed);
  const absl::string_view digits(reinterpret_cast<const char*>(ASN1_STRING_get0_data(serial)),
                                 static_cast<size_t>(ASN1_STRING_length(serial)));
  return absl::StrCat(hash, ":", absl::BytesToHexString(digits));
}

absl::Status CheckValidity(const PemFile& file, const X509* certificate, absl::Time now) {
  const absl::Time begin = ToTime(X509_get0_notBefore(certificate));
  const absl::Time end = ToTime(X509_get0_notAfter(certificate));
  const auto day = [](absl::Time time) { return absl::FormatTime("%Y-%m-%d %H:%M:%S UTC", time, absl::UTCTimeZone()); };
  if (now > end) {
    return absl::FailedPreconditionError(absl::StrCat(file.path, " expired on ", day(end), "; renew the certificate"));
  }
  if (now < begin) {
    return absl::FailedPreconditionError(
        absl::StrCat(file.path, " is not valid before ", day(begin), "; check this machine's clock"));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<PemFile> ReadPem(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(std::string contents, ReadFile(path, size_t{4} << 20));
  return PemFile{path, std::move(contents)};
}

absl::Status CheckAuthorities(const PemFile& authorities) { return CheckChain(authorities); }

absl::Status CheckKeyPair(const PemFile& certificate, const PemFile& key, absl::Time now) {
  EVPOSE_RETURN_IF_ERROR(CheckChain(certificate));
  const Owned<BIO> certificate_bio = Open(certificate);
  const Owned<X509> x509 = ReadCertificate(certificate_bio.get());
  const Owned<BIO> key_bio = Open(key);
  const Owned<EVP_PKEY> private_key(PEM_read_bio_PrivateKey(key_bio.get(), nullptr, NoPassphrase, nullptr));
  if (private_key == nullptr) {
    const bool is_encrypted = absl::StrContains(key.contents, "ENCRYPTED");
    return Invalid(key, is_encrypted
                            ? "is encrypted; write the key without a passphrase (openssl pkey -in FILE -out FILE)"
                            : "has no private key in it; PEM is expected (-----BEGIN PRIVATE KEY-----)");
  }
  if (X509_check_private_key(x509.get(), private_key.get()) != 1) {
    return Invalid(key, absl::StrCat("is not the key of ", certificate.path, "; give the key of this certificate"));
  }
  return CheckValidity(certificate, x509.get(), now);
}

absl::StatusOr<ClientPem> ReadClientPem(const std::string& ca_file, const std::string& certificate_file,
                                        const std::string& key_file, absl::Time now) {
  ClientPem pem;
  if (!ca_file.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(PemFile authorities, ReadPem(ca_file));
    EVPOSE_RETURN_IF_ERROR(CheckAuthorities(authorities));
    pem.authorities = std::move(authorities.contents);
  }
  if (certificate_file.empty()) return pem;
  EVPOSE_ASSIGN_OR_RETURN(PemFile certificate, ReadPem(certificate_file));
  EVPOSE_ASSIGN_OR_RETURN(PemFile key, ReadPem(key_file));
  EVPOSE_RETURN_IF_ERROR(CheckKeyPair(certificate, key, now));
  pem.certificate = std::move(certificate.contents);
  pem.key = std::move(key.contents);
  return pem;
}

absl::StatusOr<ClientCertificate> ReadClientCertificate(const PemFile& certificate) {
  const Owned<BIO> bio = Open(certificate);
  const Owned<X509> x509 = ReadCertificate(bio.get());
  if (x509 == nullptr) return Invalid(certificate, "has no certificate in it");
  ClientCertificate client;
  client.not_after = ToTime(X509_get0_notAfter(x509.get()));
  client.key = KeyOf(X509_get_issuer_name(x509.get()), X509_get0_serialNumber(x509.get()));
  const X509_NAME* const subject = X509_get_subject_name(x509.get());
  for (int i = -1; (i = X509_NAME_get_index_by_NID(subject, NID_commonName, i)) >= 0;) {
    unsigned char* text = nullptr;
    const int size = ASN1_STRING_to_UTF8(&text, X509_NAME_ENTRY_get_data(X509_NAME_get_entry(subject, i)));
    client.common_names.emplace_back(reinterpret_cast<const char*>(text), static_cast<size_t>(std::max(size, 0)));
    OPENSSL_free(text);
  }
  return client;
}

absl::StatusOr<Revocations> ReadRevocations(const PemFile& lists) {
  const Owned<BIO> bio = Open(lists);
  Revocations revocations;
  int num_lists = 0;
  while (const Owned<X509_CRL> list{PEM_read_bio_X509_CRL(bio.get(), nullptr, NoPassphrase, nullptr)}) {
    ++num_lists;
    const ASN1_TIME* const next_update = X509_CRL_get0_nextUpdate(list.get());
    if (next_update != nullptr) revocations.next_update = std::min(revocations.next_update, ToTime(next_update));
    STACK_OF(X509_REVOKED)* const revoked = X509_CRL_get_REVOKED(list.get());
    for (int i = 0; i < sk_X509_REVOKED_num(revoked); ++i) {
      revocations.keys.insert(
          KeyOf(X509_CRL_get_issuer(list.get()), X509_REVOKED_get0_serialNumber(sk_X509_REVOKED_value(revoked, i))));
    }
  }
  const bool is_at_end = ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
  ERR_clear_error();
  if (num_lists == 0) return Invalid(lists, "has no revocation list in it; PEM is expected (-----BEGIN X509 CRL-----)");
  if (!is_at_end) return Invalid(lists, absl::StrCat("is damaged after revocation list ", num_lists));
  return revocations;
}

}  // namespace evpose
