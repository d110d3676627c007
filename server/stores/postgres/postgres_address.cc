// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_address.h"

#include <libpq-fe.h>

#include <algorithm>
#include <memory>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"

namespace evpose::server {
namespace {

absl::Status BadPostgresAddress(absl::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat("the store's address ", what,
                   ": give postgresql://[USER[:PASSWORD]@]HOST[:PORT],.../DATABASE[?PARAMETER=VALUE&...], as libpq's "
                   "connection URIs, with %XX for reserved characters"));
}

// The place behind the host: the first / ? or the end.
size_t EndOfAuthority(absl::string_view url) {
  const size_t begin = url.find("://") + 3;
  return std::min(url.find_first_of("/?", begin), url.size());
}

}  // namespace

std::string PostgresAddress::Get(absl::string_view name) const {
  for (const auto& [parameter, value] : parameters) {
    if (parameter == name) return value;
  }
  return "";
}

std::string PostgresAddress::Printable() const {
  const std::string of_host = Get("host").empty() ? Get("hostaddr") : Get("host");
  const std::vector<std::string> hosts = absl::StrSplit(of_host, ',');
  const std::vector<std::string> ports = absl::StrSplit(Get("port"), ',');
  std::vector<std::string> servers;
  for (size_t i = 0; i < hosts.size(); ++i) {
    const std::string& port = ports.size() == hosts.size() ? ports[i] : ports[0];
    const bool is_ipv6 = absl::StrContains(hosts[i], ':');
    servers.push_back(absl::StrCat(is_ipv6 ? "[" : "", hosts[i], is_ipv6 ? "]" : "", port.empty() ? "" : ":", port));
  }
  return absl::StrCat("postgresql://", absl::StrJoin(servers, ","), "/", Get("dbname"));
}

bool IsPostgresUrl(absl::string_view url) {
  return absl::StartsWith(url, "postgresql://") || absl::StartsWith(url, "postgres://");
}

absl::StatusOr<PostgresAddress> ParsePostgresAddress(absl::string_view url) {
  if (!IsPostgresUrl(url)) return BadPostgresAddress("has another scheme than postgresql://");
  char* words = nullptr;
  const std::unique_ptr<PQconninfoOption, decltype(&PQconninfoFree)> options(
      PQconninfoParse(std::string(url).c_str(), &words), &PQconninfoFree);
  const std::unique_ptr<char, decltype(&PQfreemem)> message(words, &PQfreemem);
  if (options == nullptr) {
    // libpq's message may contain a part of the URI, and so of the password.
    const bool may_have_password = absl::StrContains(url, '@') || absl::StrContains(url, "password");
    absl::string_view detail = message == nullptr || may_have_password ? "" : message.get();
    while (absl::EndsWith(detail, "\n")) detail.remove_suffix(1);
    return BadPostgresAddress(absl::StrCat("cannot be parsed", detail.empty() ? "" : ": ", detail));
  }
  PostgresAddress address;
  for (const PQconninfoOption* option = options.get(); option->keyword != nullptr; ++option) {
    if (option->val != nullptr) address.parameters.emplace_back(option->keyword, option->val);
  }
  if (address.Get("dbname").empty()) return BadPostgresAddress("has no database");
  const std::string attributes = address.Get("target_session_attrs");
  if (attributes.empty()) {
    address.parameters.emplace_back("target_session_attrs", "read-write");
  } else if (attributes != "read-write" && attributes != "primary") {
    return BadPostgresAddress(
        "has target_session_attrs with another value than read-write and primary, but the store writes");
  }
  return address;
}

std::string WithPostgresPassword(absl::string_view url, absl::string_view escaped_password) {
  const size_t begin = url.find("://") + 3;
  const size_t at = url.substr(0, EndOfAuthority(url)).rfind('@');
  const bool has_user = at != absl::string_view::npos;
  const size_t place = has_user ? at : begin;
  const bool has_colon = has_user && url[at - 1] == ':' && at > begin;
  return absl::StrCat(url.substr(0, place), has_colon ? "" : ":", escaped_password, has_user ? "" : "@",
                      url.substr(place));
}

}  // namespace evpose::server
