// SPDX-License-Identifier: Apache-2.0

// The server's certificate, its key and the authorities for client certificates. The files are read again when they
// change, or after an error of reading.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/auth/file_stamp.h"
#include "server/auth/read_schedule.h"

namespace evpose::server {

// Paths of PEM files. All empty: no TLS.
struct TlsPaths {
  std::string certificate;  // the server's, with its chain
  std::string key;
  std::string client_ca;   // authorities of client certificates, which are then required; empty: none are requested
  std::string client_crl;  // revoked client certificates, read by the Authenticator; empty: none

  bool has_tls() const { return !certificate.empty(); }
  // Errors: INVALID_ARGUMENT naming the missing option.
  absl::Status Validate() const;
};

struct TlsMaterial {
  std::string certificate_pem;
  std::string key_pem;
  std::string client_ca_pem;
};

// Thread-safe.
class TlsFiles {
  using Stamps = std::array<FileStamp, 3>;

 public:
  using Schedule = ReadSchedule<Stamps>;

  // Errors, which name the file and the remedy: those of reading, and of core/base/certificates.h. A key file that
  // other users can access is reported in the log.
  static absl::StatusOr<std::unique_ptr<TlsFiles>> Open(const TlsPaths& paths,
                                                        Schedule::Now now = Schedule::Clock::now);

  // Returns the contents of the files; the same pointer while they do not change. When the new files do not match each
  // other, are damaged or have expired, the log has an error and the previous contents stay in use; so the files may be
  // replaced in any order.
  std::shared_ptr<const TlsMaterial> Current();

 private:
  TlsFiles(const TlsPaths& paths, Schedule::Now now) : paths_(paths), schedule_(std::move(now)) {}
  Stamps ReadStamps() const;
  absl::StatusOr<std::shared_ptr<const TlsMaterial>> Read() const;

  const TlsPaths paths_;
  std::mutex mutex_;
  Schedule schedule_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const TlsMaterial> material_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
