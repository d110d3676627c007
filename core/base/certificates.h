// SPDX-License-Identifier: Apache-2.0

// Checks of X.509 certificates and their keys in PEM, so that a mistake in a file is told in words before TLS fails
// over it in codes.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace evpose {

// A file's contents, with the name for messages.
struct PemFile {
  std::string path;
  std::string contents;
};

// Certificates of authorities: at least one, each readable. Errors: INVALID_ARGUMENT naming the path.
absl::Status CheckAuthorities(const PemFile& authorities);

// A certificate, first of its chain, and its private key. Errors name the path and say what to do: INVALID_ARGUMENT for
// what is no PEM, an encrypted key, a key of another certificate; FAILED_PRECONDITION for a certificate that is not
// valid at `now`.
absl::Status CheckKeyPair(const PemFile& certificate, const PemFile& key, absl::Time now);

}  // namespace evpose
