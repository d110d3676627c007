// SPDX-License-Identifier: Apache-2.0

// Bearer tokens: a file that maps the digest of each to a tenant.
//
//   # tenant  SHA-256 of the token, in hex                                      role
//   lab       9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08
//   admin     60303ae22b998861bce3b28f33eec1be758a213c86c93c076dbe9f558c11c752  operator
//
// A tenant may have several tokens: a new one is added before the old one goes. The tokens themselves are random
// numbers of 256 bits (NewToken), so their digests give nothing away; the file is still nobody else's business.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/auth/caller.h"
#include "server/auth/file_stamp.h"

namespace evpose::server {

// 1 to 63 letters, digits, '.', '_' and '-', the first a letter or digit. INVALID_ARGUMENT otherwise.
absl::Status ValidateTenant(absl::string_view tenant);

struct NewToken {
  std::string token;  // a secret: "evpose_" and 64 hex digits
  std::string line;   // for the token file
};
// Errors: INVALID_ARGUMENT for the tenant's name, INTERNAL when the system gives no random numbers.
absl::StatusOr<NewToken> MakeToken(absl::string_view tenant, bool is_operator);

// Adds a line to the file at `path`; makes the file, for its owner only, when there is none. Errors: INVALID_ARGUMENT
// naming path and line for a file that is no token file; those of writing, naming the path.
absl::Status AppendTokenLine(const std::string& path, const std::string& line);

class TokenTable {
 public:
  // `path` is for the messages. Errors: INVALID_ARGUMENT naming path and line; never a word of the line's second
  // field, which may be a token that was put there by mistake.
  static absl::StatusOr<TokenTable> Parse(absl::string_view text, const std::string& path);

  // Looks at every entry, each in constant time: how long it takes says nothing about the token or the place of its
  // entry. Absent: nobody has this token.
  std::optional<Caller> Find(absl::string_view token) const;

  size_t size() const { return entries_.size(); }

 private:
  using Digest = std::array<uint8_t, 32>;
  struct Entry {
    Digest digest;
    Caller caller;
  };
  absl::Status AddLine(absl::string_view line);

  std::vector<Entry> entries_;
};

// The file, read again when it changes. Thread-safe.
class TokenFile {
 public:
  // Errors: those of reading, and of TokenTable::Parse; INVALID_ARGUMENT for a file without any token. A file that
  // others may read is warned about in the log.
  static absl::StatusOr<std::unique_ptr<TokenFile>> Open(const std::string& path);

  // As TokenTable::Find, in the file as it is now. A new version with a mistake in it, or none at all, is refused in
  // the log and the old one stays.
  std::optional<Caller> Find(absl::string_view token);

 private:
  explicit TokenFile(const std::string& path) : path_(path) {}
  absl::StatusOr<TokenTable> Read() const;
  void Refresh() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const std::string path_;
  std::mutex mutex_;
  FileStamp stamp_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const TokenTable> table_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
