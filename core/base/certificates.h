// SPDX-License-Identifier: Apache-2.0

// Checks of X.509 certificates and private keys in PEM before TLS uses them. TLS reports a wrong file with an error
// code only; these errors say which file is wrong and how to correct it.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace evpose {

// The contents of a PEM file, with its path for error messages.
struct PemFile {
  std::string path;
  std::string contents;
};

// Reads a PEM file of at most 4 MB; a bundle of all public authorities has 0.2 MB. Errors: those of ReadFile().
absl::StatusOr<PemFile> ReadPem(const std::string& path);

// Checks a file of authorities: at least one certificate, each of them readable. Errors: INVALID_ARGUMENT with the
// path.
absl::Status CheckAuthorities(const PemFile& authorities);

// Checks a certificate (the first of the chain in its file) and its private key. Errors have the path and the remedy:
// INVALID_ARGUMENT for a file that is not PEM, an encrypted key or the key of another certificate; FAILED_PRECONDITION
// for a certificate that is not valid at `now`.
absl::Status CheckKeyPair(const PemFile& certificate, const PemFile& key, absl::Time now);

// What a client presents and trusts in TLS: the contents of PEM files. Empty if no file is given.
struct ClientPem {
  std::string authorities;
  std::string certificate;
  std::string key;
};
// Reads and checks the files of a client; an empty path stands for none. Without `certificate_file`, `key_file` is not
// read. Errors: those of ReadPem(), CheckAuthorities() and CheckKeyPair().
absl::StatusOr<ClientPem> ReadClientPem(const std::string& ca_file, const std::string& certificate_file,
                                        const std::string& key_file, absl::Time now);

// The fields of a client's certificate that a server checks after TLS has verified the signatures.
struct ClientCertificate {
  std::vector<std::string> common_names;  // all CNs of the subject, UTF-8
  absl::Time not_after;
  std::string key;  // issuer and serial number, as in Revocations::keys
};
// Reads the first certificate. Errors: INVALID_ARGUMENT.
absl::StatusOr<ClientCertificate> ReadClientCertificate(const PemFile& certificate);

// The certificates that the lists of a file (CRLs) revoke.
struct Revocations {
  std::set<std::string> keys;
  absl::Time next_update = absl::InfiniteFuture();  // the earliest time at which an authority promised a newer list
};
// The signatures of the lists are not checked: the operator of the server vouches for the file. Errors:
// INVALID_ARGUMENT with the path: no list in the file, or a damaged one.
absl::StatusOr<Revocations> ReadRevocations(const PemFile& lists);

}  // namespace evpose
