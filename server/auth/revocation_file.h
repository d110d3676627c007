// SPDX-License-Identifier: Apache-2.0

// Certificate revocation lists (CRLs) of the authorities of client certificates. gRPC 1.51 has no lists for the
// credentials that the server uses, so the Authenticator looks up each certificate.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "core/base/certificates.h"
#include "server/auth/watched_file.h"

namespace evpose::server {

using RevocationFile = WatchedFile<Revocations>;

// Opens a PEM file with one or more lists. A new version that is missing or damaged is reported in the log as an error,
// and the previous lists stay in use; so do lists whose next update is due, which are reported as a warning. Errors:
// those of ReadPem() and ReadRevocations().
absl::StatusOr<std::unique_ptr<RevocationFile>> OpenRevocationFile(const std::string& path);

}  // namespace evpose::server
