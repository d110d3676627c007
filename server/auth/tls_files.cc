// SPDX-License-Identifier: Apache-2.0
#include "server/auth/tls_files.h"

#include <sys/stat.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/certificates.h"
#include "core/base/status_macros.h"
#include "server/telemetry/log.h"

namespace evpose::server {
absl::Status TlsPaths::Validate() const {
  if (certificate.empty() != key.empty()) {
    return absl::InvalidArgumentError(certificate.empty() ? "--tls-key needs --tls-cert, the certificate of that key"
                                                          : "--tls-cert needs --tls-key, the key of that certificate");
  }
  if (certificate.empty() && !client_ca.empty()) {
    return absl::InvalidArgumentError("--tls-client-ca needs --tls-cert and --tls-key: the server's own certificate");
  }
  if (client_ca.empty() && !client_crl.empty()) {
    return absl::InvalidArgumentError(
        "--tls-client-crl needs --tls-client-ca: without it clients have no certificates");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<TlsFiles>> TlsFiles::Open(const TlsPaths& paths, Schedule::Now now) {
  EVPOSE_RETURN_IF_ERROR(paths.Validate());
  std::unique_ptr<TlsFiles> files(new TlsFiles(paths, std::move(now)));
  const Stamps stamps = files->ReadStamps();
  EVPOSE_ASSIGN_OR_RETURN(auto material, files->Read());
  if ((StampOf(paths.key).mode & (S_IRWXG | S_IRWXO) & ~S_IRGRP) != 0) {
    Log(LogLevel::kWarning, "key_exposed",
        {{"file", paths.key}, {"message", "other users can access this private key: run chmod 600 on it"}});
  }
  const std::lock_guard lock(files->mutex_);
  files->schedule_.OnRead(stamps, absl::OkStatus());
  files->material_ = std::move(material);
  return files;
}

TlsFiles::Stamps TlsFiles::ReadStamps() const {
  return {StampOf(paths_.certificate), StampOf(paths_.key), StampOf(paths_.client_ca)};
}

absl::StatusOr<std::shared_ptr<const TlsMaterial>> TlsFiles::Read() const {
  EVPOSE_ASSIGN_OR_RETURN(PemFile certificate, ReadPem(paths_.certificate));
  EVPOSE_ASSIGN_OR_RETURN(PemFile key, ReadPem(paths_.key));
  EVPOSE_RETURN_IF_ERROR(CheckKeyPair(certificate, key, absl::Now()));
  PemFile client_ca;
  if (!paths_.client_ca.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(client_ca, ReadPem(paths_.client_ca));
    EVPOSE_RETURN_IF_ERROR(CheckAuthorities(client_ca));
  }
  return std::make_shared<const TlsMaterial>(
      TlsMaterial{std::move(certificate.contents), std::move(key.contents), std::move(client_ca.contents)});
}

std::shared_ptr<const TlsMaterial> TlsFiles::Current() {
  const std::lock_guard lock(mutex_);
  const Stamps stamps = ReadStamps();
  if (!schedule_.IsDue(stamps)) return material_;
  auto material = Read();
  const bool is_new = schedule_.OnRead(stamps, material.status());
  if (material.ok()) {
    Log(LogLevel::kInfo, "certificates_read", {{"file", paths_.certificate}});
    material_ = *std::move(material);
  } else if (is_new) {
    Log(LogLevel::kError, "certificates_not_read",
        {{"message", absl::StrCat("the previous certificates stay in use: ", material.status().message())}});
  }
  return material_;
}

}  // namespace evpose::server
