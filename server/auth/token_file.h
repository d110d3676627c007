// SPDX-License-Identifier: Apache-2.0

// Bearer tokens: a file that maps the digests of tokens to tenants.
//
//   # tenant  SHA-256 of the token, in hex                                      role
//   lab       9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08
//   admin     60303ae22b998861bce3b28f33eec1be758a213c86c93c076dbe9f558c11c752  operator
//
// A tenant may have several tokens, so that a new one can be added before the old one is removed. Tokens are random
// numbers of 256 bits (NewToken), so they cannot be derived from their digests. The file should be readable by its
// owner only, because it lists the tenants.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/auth/caller.h"
#include "server/auth/watched_file.h"

namespace evpose::server {

// Checks the name of a tenant: 1 to 63 letters, digits, '.', '_' and '-', the first a letter or digit. Errors:
// INVALID_ARGUMENT.
absl::Status ValidateTenant(absl::string_view tenant);

struct NewToken {
  std::string token;  // a secret: "evpose_" and 64 hex digits
  std::string line;   // for the token file
};
// Makes a random token. Errors: INVALID_ARGUMENT for the tenant's name, INTERNAL when the system's random source fails.
absl::StatusOr<NewToken> MakeToken(absl::string_view tenant, bool is_operator);

// Appends a line to the file at `path`, or creates the file with access for its owner only. Errors: INVALID_ARGUMENT,
// naming path and line, when the file is not a valid token file; those of writing, naming the path.
absl::Status AppendTokenLine(const std::string& path, const std::string& line);

// The parsed contents of a token file.
class TokenTable {
 public:
  // The text may have no token. `path` is used in messages. Errors: INVALID_ARGUMENT naming path and line. A message
  // never contains the second field of a line, which may be a token that was entered by mistake.
  static absl::StatusOr<TokenTable> Parse(absl::string_view text, const std::string& path);

  // Returns the caller with this token, if any. Compares with every entry in constant time, so that the duration
  // reveals neither the token nor the position of its entry.
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

// A token file that is read again when it changes. Thread-safe.
class TokenFile {
 public:
  // Errors: those of reading, and of TokenTable::Parse; INVALID_ARGUMENT for a file without tokens. A file that other
  // users can access is reported in the log.
  static absl::StatusOr<std::unique_ptr<TokenFile>> Open(const std::string& path);

  // Returns TokenTable::Find() of the current contents of the file. A file that has been deleted or has no line with a
  // token admits nobody. When a new version cannot be read or parsed, the previous tokens stay valid. Both are errors
  // in the log.
  std::optional<Caller> Find(absl::string_view token) { return table_->Current()->Find(token); }
  size_t size() { return table_->Current()->size(); }
  // Increases whenever the tokens change.
  uint64_t version() { return table_->version(); }

 private:
  using Table = WatchedFile<TokenTable>;
  explicit TokenFile(std::unique_ptr<Table> table) : table_(std::move(table)) {}

  const std::unique_ptr<Table> table_;
};

}  // namespace evpose::server
