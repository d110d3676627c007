// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_address.h"

#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

absl::Status BadAddress(absl::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat("the store's address has ", what,
                   ": give redis://[USER:PASSWORD@]HOST:PORT[/DATABASE] or "
                   "redis+sentinel://[USER:PASSWORD@]HOST:PORT,HOST:PORT,HOST:PORT/NAME[/DATABASE]"));
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

absl::Status ParseDatabase(absl::string_view text, int& database) {
  if (text.empty() || (absl::SimpleAtoi(text, &database) && database >= 0)) return absl::OkStatus();
  return BadAddress("a database that is no number");
}

// Parses HOST[:PORT]. An IPv6 address is enclosed in brackets.
absl::StatusOr<RedisHost> ParseHost(absl::string_view text, int default_port) {
  RedisHost host = {.host = "", .port = default_port};
  const size_t bracket = text.find(']');
  const size_t colon = text.find(':', bracket == absl::string_view::npos ? 0 : bracket);
  if (colon != absl::string_view::npos) {
    const absl::string_view port = text.substr(colon + 1);
    if (!absl::SimpleAtoi(port, &host.port) || host.port < 1 || host.port > 65535) {
      return BadAddress("a port that is not within 1 and 65535");
    }
    text = text.substr(0, colon);
  }
  absl::ConsumePrefix(&text, "[");
  absl::ConsumeSuffix(&text, "]");
  if (text.empty()) return BadAddress("no host");
  host.host = std::string(text);
  return host;
}

// Parses HOST[:PORT][/DATABASE].
absl::Status ParseServer(absl::string_view text, RedisAddress& address) {
  const std::pair<absl::string_view, absl::string_view> parts = absl::StrSplit(text, absl::MaxSplits('/', 1));
  EVPOSE_RETURN_IF_ERROR(ParseDatabase(parts.second, address.database));
  EVPOSE_ASSIGN_OR_RETURN(const RedisHost server, ParseHost(parts.first, address.port));
  address.host = server.host;
  address.port = server.port;
  return absl::OkStatus();
}

// Parses HOST[:PORT],.../NAME[/DATABASE].
absl::Status ParseSentinels(absl::string_view text, RedisAddress& address) {
  constexpr int kSentinelPort = 26379;
  const std::vector<absl::string_view> parts = absl::StrSplit(text, absl::MaxSplits('/', 2));
  if (parts.size() < 2 || parts[1].empty()) return BadAddress("no name of the master behind the Sentinels");
  address.master_name = std::string(parts[1]);
  if (parts.size() == 3) EVPOSE_RETURN_IF_ERROR(ParseDatabase(parts[2], address.database));
  for (const absl::string_view sentinel : absl::StrSplit(parts[0], ',')) {
    EVPOSE_ASSIGN_OR_RETURN(RedisHost host, ParseHost(sentinel, kSentinelPort));
    address.sentinels.push_back(std::move(host));
  }
  return absl::OkStatus();
}

}  // namespace

std::string RedisHost::Printable() const {
  return absl::StrContains(host, ':') ? absl::StrCat("[", host, "]:", port) : absl::StrCat(host, ":", port);
}

std::string RedisAddress::Printable() const {
  if (!sentinels.empty()) {
    const std::string hosts = absl::StrJoin(
        sentinels, ",", [](std::string* out, const RedisHost& sentinel) { out->append(sentinel.Printable()); });
    return absl::StrCat("redis+sentinel://", hosts, "/", master_name, "/", database);
  }
  if (host.empty()) return absl::StrCat("redis+unix://", socket_path);
  return absl::StrCat("redis://", RedisHost{host, port}.Printable(), "/", database);
}

absl::StatusOr<RedisAddress> ParseRedisAddress(absl::string_view url) {
  if (absl::StartsWith(url, "rediss://") || absl::StartsWith(url, "rediss+sentinel://")) {
    return absl::UnimplementedError(
        absl::StrCat(url.substr(0, url.find(':')), ":// is not supported: Debian 12's hiredis has no TLS; use ",
                     absl::StartsWith(url, "rediss:") ? "redis://" : "redis+sentinel://",
                     " on a private network, or a local stunnel or proxy that connects to the Redis server with TLS"));
  }
  RedisAddress address;
  if (absl::ConsumePrefix(&url, "redis+unix://")) {
    EVPOSE_RETURN_IF_ERROR(ParseUser(url, address));
    if (!absl::StartsWith(url, "/")) return BadAddress("no absolute path of a socket");
    address.socket_path = std::string(url);
    return address;
  }
  const bool has_sentinels = absl::ConsumePrefix(&url, "redis+sentinel://");
  if (!has_sentinels && !absl::ConsumePrefix(&url, "redis://")) {
    return BadAddress("another scheme than redis:// and redis+sentinel://");
  }
  EVPOSE_RETURN_IF_ERROR(ParseUser(url, address));
  EVPOSE_RETURN_IF_ERROR(has_sentinels ? ParseSentinels(url, address) : ParseServer(url, address));
  return address;
}

}  // namespace evpose::server
