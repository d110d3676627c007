// SPDX-License-Identifier: Apache-2.0
#include "server/auth/revocation_file.h"

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/status_macros.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

absl::StatusOr<Revocations> ReadLists(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(const PemFile file, ReadPem(path));
  EVPOSE_ASSIGN_OR_RETURN(Revocations revocations, ReadRevocations(file));
  if (revocations.next_update < absl::Now()) {
    Log(LogLevel::kWarning, "revocations_outdated",
        {{"file", path}, {"message", "the next update of a revocation list is due; the list stays in use"}});
  }
  return revocations;
}

void LogRevocations(const std::string& path, const absl::StatusOr<Revocations>& revocations) {
  if (revocations.ok()) {
    Log(LogLevel::kInfo, "revocations_read", {{"file", path}, {"certificates", revocations->keys.size()}});
  } else {
    Log(LogLevel::kError, "revocations_not_read",
        {{"message", absl::StrCat("the previous revocations stay in use: ", revocations.status().message())}});
  }
}

}  // namespace

absl::StatusOr<std::unique_ptr<RevocationFile>> OpenRevocationFile(const std::string& path) {
  return RevocationFile::Open(path, ReadLists, [path](const auto& revocations) { LogRevocations(path, revocations); });
}

}  // namespace evpose::server
