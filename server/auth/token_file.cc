// SPDX-License-Identifier: Apache-2.0
#include "server/auth/token_file.h"

#include <openssl/crypto.h>
#include <sys/stat.h>

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"
#include "server/runtime/random_name.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

constexpr size_t kMaxTokenFileBytes = 1u << 20;  // bounds memory; a line of a token has some hundred bytes
constexpr size_t kMaxTenantBytes = 63;           // as in kTenantRule
constexpr size_t kDigestHexDigits = 64;          // of SHA-256
constexpr absl::string_view kTokenPrefix = "evpose_";
constexpr absl::string_view kOperator = "operator";
constexpr absl::string_view kTenantRule = "1 to 63 letters, digits, '.', '_' and '-', the first a letter or digit";

std::string HexDigest(absl::string_view text) {
  return Sha256Hex(absl::MakeConstSpan(reinterpret_cast<const uint8_t*>(text.data()), text.size()));
}

bool IsHexDigest(absl::string_view text) {
  return text.size() == kDigestHexDigits && std::all_of(text.begin(), text.end(), absl::ascii_isxdigit);
}

template <typename Digest>
Digest ToDigest(absl::string_view hex) {
  const std::string bytes = absl::HexStringToBytes(hex);
  Digest digest;
  std::copy(bytes.begin(), bytes.end(), digest.begin());
  return digest;
}

bool IsTenantByte(char c) { return absl::ascii_isalnum(c) || c == '.' || c == '_' || c == '-'; }

bool IsTenant(absl::string_view text) {
  return !text.empty() && text.size() <= kMaxTenantBytes && absl::ascii_isalnum(text.front()) &&
         std::all_of(text.begin(), text.end(), IsTenantByte);
}

std::string_view View(absl::string_view text) { return {text.data(), text.size()}; }

// A missing file is read as an empty one: deleting the file withdraws all tokens.
absl::StatusOr<TokenTable> ReadTokens(const std::string& path) {
  const absl::StatusOr<std::string> text = ReadFile(path, kMaxTokenFileBytes);
  if (!text.ok() && !absl::IsNotFound(text.status())) return text.status();
  return TokenTable::Parse(text.ok() ? *text : "", path);
}

void LogTokens(const std::string& path, const absl::StatusOr<TokenTable>& table) {
  if (!table.ok()) {
    Log(LogLevel::kError, "tokens_not_read",
        {{"message", absl::StrCat("the previous tokens stay valid: ", table.status().message())}});
  } else if (table->size() == 0) {
    Log(LogLevel::kError, "no_tokens", {{"message", absl::StrCat(path, " is missing or empty: nobody is admitted")}});
  } else {
    Log(LogLevel::kInfo, "tokens_read", {{"file", path}, {"tokens", table->size()}});
  }
}

}  // namespace

absl::Status ValidateTenant(absl::string_view tenant) {
  if (IsTenant(tenant)) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("\"", absl::CHexEscape(tenant.substr(0, kMaxTenantBytes + 1)),
                                                 "\" is not a tenant's name: ", kTenantRule));
}

absl::StatusOr<NewToken> MakeToken(absl::string_view tenant, bool is_operator) {
  EVPOSE_RETURN_IF_ERROR(ValidateTenant(tenant));
  EVPOSE_ASSIGN_OR_RETURN(const std::string first, RandomHex128());
  EVPOSE_ASSIGN_OR_RETURN(const std::string second, RandomHex128());
  NewToken made;
  made.token = absl::StrCat(kTokenPrefix, first, second);
  made.line = absl::StrCat(tenant, " ", HexDigest(made.token), is_operator ? " operator" : "");
  return made;
}

absl::Status AppendTokenLine(const std::string& path, const std::string& line) {
  std::string text;
  const bool is_new = !StampOf(path).exists;
  if (!is_new) {
    EVPOSE_ASSIGN_OR_RETURN(text, ReadFile(path, kMaxTokenFileBytes));
    if (!text.empty() && text.back() != '\n') text += '\n';
  }
  absl::StrAppend(&text, line, "\n");
  EVPOSE_RETURN_IF_ERROR(TokenTable::Parse(text, path).status());
  // The file is replaced atomically, because a server may be reading it. An existing file keeps its mode.
  const mode_t mode = is_new ? S_IRUSR | S_IWUSR : StampOf(path).mode & 0777;
  EVPOSE_RETURN_IF_ERROR(WriteFile(path, View(text)));
  if (chmod(path.c_str(), mode) == 0) return absl::OkStatus();
  return absl::PermissionDeniedError(absl::StrCat(path, ": its mode cannot be set"));
}

absl::StatusOr<TokenTable> TokenTable::Parse(absl::string_view text, const std::string& path) {
  TokenTable table;
  int line_number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++line_number;
    const absl::Status added = table.AddLine(line.substr(0, line.find('#')));
    if (!added.ok()) return absl::InvalidArgumentError(absl::StrCat(path, ":", line_number, ": ", added.message()));
  }
  return table;
}

absl::Status TokenTable::AddLine(absl::string_view line) {
  const std::vector<absl::string_view> fields = absl::StrSplit(line, absl::ByAnyChar(" \t\r"), absl::SkipEmpty());
  if (fields.empty()) return absl::OkStatus();
  if (fields.size() == 1) {
    return absl::InvalidArgumentError(
        "has one field only: write TENANT, the SHA-256 of its token in hexadecimal, and optionally the word "
        "`operator`");
  }
  if (!IsTenant(fields[0]) || IsHexDigest(fields[0])) {
    return absl::InvalidArgumentError(absl::StrCat("the first field is not a tenant's name: ", kTenantRule));
  }
  if (!IsHexDigest(fields[1])) {
    return absl::InvalidArgumentError(
        "the second field is no SHA-256 in hex. If it is the token itself, others may have read it: "
        "make another one with evpose-server --new-token TENANT. The digest of a token is "
        "printf %s \"$TOKEN\" | sha256sum");
  }
  if (fields.size() > 3 || (fields.size() == 3 && fields[2] != kOperator)) {
    return absl::InvalidArgumentError("only the word `operator` may follow the SHA-256: remove the other fields");
  }
  const auto digest = ToDigest<Digest>(fields[1]);
  const bool is_known =
      std::any_of(entries_.begin(), entries_.end(), [&digest](const Entry& entry) { return entry.digest == digest; });
  if (is_known) return absl::InvalidArgumentError("an earlier line has the same token: each belongs to one tenant");
  entries_.push_back({digest, {std::string(fields[0]), fields.size() == 3}});
  return absl::OkStatus();
}

std::optional<Caller> TokenTable::Find(absl::string_view token) const {
  const auto digest = ToDigest<Digest>(HexDigest(token));
  size_t found = entries_.size();
  for (size_t i = 0; i < entries_.size(); ++i) {
    const bool differs = CRYPTO_memcmp(entries_[i].digest.data(), digest.data(), digest.size()) != 0;
    found = differs ? found : i;
  }
  if (found == entries_.size()) return std::nullopt;
  return entries_[found].caller;
}

absl::StatusOr<std::unique_ptr<TokenFile>> TokenFile::Open(const std::string& path) {
  const mode_t mode = StampOf(path).mode;
  EVPOSE_RETURN_IF_ERROR(ReadFile(path, kMaxTokenFileBytes).status());
  EVPOSE_ASSIGN_OR_RETURN(auto table,
                          Table::Open(path, ReadTokens, [path](const auto& read) { LogTokens(path, read); }));
  const size_t num_tokens = table->Current()->size();
  if (num_tokens == 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        path,
        ": the file has no token, so no client could use the server; evpose-server --new-token TENANT makes one"));
  }
  if ((mode & (S_IWGRP | S_IROTH | S_IWOTH)) != 0) {
    Log(LogLevel::kWarning, "token_file_exposed",
        {{"file", path}, {"message", "other users can read or write the file: run chmod 600 on it"}});
  }
  Log(LogLevel::kInfo, "tokens_read", {{"file", path}, {"tokens", num_tokens}});
  return std::unique_ptr<TokenFile>(new TokenFile(std::move(table)));
}

}  // namespace evpose::server
