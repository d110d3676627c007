// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_address.h"

#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

absl::Status BadAddress(absl::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat("the store's address has ", what, ": give redis://[USER:PASSWORD@]HOST:PORT[/DATABASE]"));
}

absl::StatusOr<std::string> Unescape(absl::string_view text) {
  std::string plain;
  for (size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '%') {
      plain += text[i];
      continue;
    }
    if (i + 2 >= text.size() || !absl::ascii_isxdigit(text[i + 1]) || !absl::ascii_isxdigit(text[i + 2])) {
      return BadAddress("a % without two hex digits before the @");
    }
    plain += absl::HexStringToBytes(text.substr(i + 1, 2));
    i += 2;
  }
  return plain;
}

// Parses [USER:]PASSWORD@ and removes it from `rest`; without an @, does nothing.
absl::Status ParseUser(absl::string_view& rest, RedisAddress& address) {
  const size_t at = rest.rfind('@');
  if (at == absl::string_view::npos) return absl::OkStatus();
  const absl::string_view user = rest.substr(0, at);
  rest.remove_prefix(at + 1);
  const size_t colon = user.find(':');
  if (colon != absl::string_view::npos) {
    EVPOSE_ASSIGN_OR_RETURN(address.user, Unescape(user.substr(0, colon)));
  }
  EVPOSE_ASSIGN_OR_RETURN(address.password, Unescape(colon == absl::string_view::npos ? user : user.substr(colon + 1)));
  return absl::OkStatus();
}

absl::Status ParseHost(absl::string_view rest, RedisAddress& address) {
  if (const size_t slash = rest.find('/'); slash != absl::string_view::npos) {
    const absl::string_view database = rest.substr(slash + 1);
    if (!database.empty() && (!absl::SimpleAtoi(database, &address.database) || address.database < 0)) {
      return BadAddress("a database that is no number");
    }
    rest = rest.substr(0, slash);
  }
  // An IPv6 address is enclosed in brackets.
  const size_t bracket = rest.find(']');
  const size_t colon = rest.find(':', bracket == absl::string_view::npos ? 0 : bracket);
  if (colon != absl::string_view::npos) {
    const absl::string_view port = rest.substr(colon + 1);
    if (!absl::SimpleAtoi(port, &address.port) || address.port < 1 || address.port > 65535) {
      return BadAddress("a port that is not within 1 and 65535");
    }
    rest = rest.substr(0, colon);
  }
  absl::ConsumePrefix(&rest, "[");
  absl::ConsumeSuffix(&rest, "]");
  if (rest.empty()) return BadAddress("no host");
  address.host = std::string(rest);
  return absl::OkStatus();
}

}  // namespace

std::string RedisAddress::Printable() const {
  return host.empty() ? absl::StrCat("redis+unix://", socket_path)
                      : absl::StrCat("redis://", host, ":", port, "/", database);
}

absl::StatusOr<RedisAddress> ParseRedisAddress(absl::string_view url) {
  if (absl::StartsWith(url, "rediss://")) {
    return absl::UnimplementedError(
        "rediss:// is not supported: Debian 12's hiredis has no TLS; use redis:// on a private network, or a local "
        "stunnel or proxy that connects to the Redis server with TLS");
  }
  RedisAddress address;
  if (absl::ConsumePrefix(&url, "redis+unix://")) {
    EVPOSE_RETURN_IF_ERROR(ParseUser(url, address));
    if (!absl::StartsWith(url, "/")) return BadAddress("no absolute path of a socket");
    address.socket_path = std::string(url);
    return address;
  }
  if (!absl::ConsumePrefix(&url, "redis://")) return BadAddress("another scheme than redis://");
  EVPOSE_RETURN_IF_ERROR(ParseUser(url, address));
  EVPOSE_RETURN_IF_ERROR(ParseHost(url, address));
  return address;
}

}  // namespace evpose::server
