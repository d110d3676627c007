// SPDX-License-Identifier: Apache-2.0

// The server's certificate, its key and the authorities of its clients, read again when they change.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/auth/file_stamp.h"

namespace evpose::server {

// Paths of PEM files. All empty: no TLS.
struct TlsPaths {
  std::string certificate;  // the server's, with its chain
  std::string key;
  std::string client_ca;  // clients must show a certificate signed by one of these; empty: they show none

  bool has_tls() const { return !certificate.empty(); }
  // INVALID_ARGUMENT naming the option that is missing.
  absl::Status Validate() const;
};

struct TlsMaterial {
  std::string certificate_pem;
  std::string key_pem;
  std::string client_ca_pem;
};

// Thread-safe.
class TlsFiles {
 public:
  // Errors name the file and say what to do: those of reading, and of core/base/certificates.h. A key that others may
  // read is warned about in the log.
  static absl::StatusOr<std::unique_ptr<TlsFiles>> Open(const TlsPaths& paths);

  // What the files hold now; the same pointer while they do not change. New files that do not belong together, or are
  // damaged or expired, are refused in the log, and the old ones stay: so the order in which they are replaced is free.
  std::shared_ptr<const TlsMaterial> Current();

 private:
  using Stamps = std::array<FileStamp, 3>;

  explicit TlsFiles(const TlsPaths& paths) : paths_(paths) {}
  Stamps ReadStamps() const;
  absl::StatusOr<std::shared_ptr<const TlsMaterial>> Read() const;

  const TlsPaths paths_;
  std::mutex mutex_;
  Stamps stamps_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const TlsMaterial> material_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
