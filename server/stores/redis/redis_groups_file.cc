// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_groups_file.h"

#include <algorithm>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

constexpr size_t kMaxFileBytes = 64u << 10;  // kMaxGroups lines of 1 KiB
constexpr size_t kMaxGroups = 64;            // each then has four of the 256 buckets
constexpr size_t kMaxNameBytes = 32;         // names are labels of metrics and parts of errors

bool IsGroupName(absl::string_view name) {
  return !name.empty() && name.size() <= kMaxNameBytes &&
         std::all_of(name.begin(), name.end(), [](char c) { return absl::ascii_isalnum(c) || c == '-'; });
}

// `words`: of a line.
absl::StatusOr<RedisGroupAddress> ParseGroup(const std::vector<absl::string_view>& words, const std::string& password) {
  if (words.size() != 2) return absl::InvalidArgumentError("is not NAME ADDRESS");
  if (!IsGroupName(words[0])) {
    return absl::InvalidArgumentError("the name of a group has 1 to 32 letters, digits and hyphens");
  }
  RedisGroupAddress group = {.name = std::string(words[0])};
  EVPOSE_ASSIGN_OR_RETURN(group.address, ParseRedisAddress(words[1]));
  if (group.address.password.empty()) group.address.password = password;
  return group;
}

}  // namespace

absl::StatusOr<std::vector<RedisGroupAddress>> ParseRedisGroups(absl::string_view text, const std::string& password) {
  std::vector<RedisGroupAddress> groups;
  size_t number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++number;
    line = line.substr(0, line.find('#'));
    const std::vector<absl::string_view> words = absl::StrSplit(line, absl::ByAnyChar(" \t\r"), absl::SkipEmpty());
    if (words.empty()) continue;
    absl::StatusOr<RedisGroupAddress> group = ParseGroup(words, password);
    absl::Status status = group.status();
    const auto is_same = [&](const RedisGroupAddress& other) { return group.ok() && other.name == group->name; };
    if (std::any_of(groups.begin(), groups.end(), is_same)) {
      status = absl::InvalidArgumentError(absl::StrCat("the group ", group->name, " has a line already"));
    }
    if (groups.size() == kMaxGroups) status = absl::InvalidArgumentError("there are more than 64 groups");
    if (!status.ok()) {
      return absl::Status(status.code(), absl::StrCat("line ", number, ": ", status.message()));
    }
    groups.push_back(*std::move(group));
  }
  if (groups.empty()) return absl::InvalidArgumentError("there is no group: give each a line NAME ADDRESS");
  return groups;
}

absl::StatusOr<std::vector<RedisGroupAddress>> ReadRedisGroups(const std::string& file, const std::string& password) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadFile(file, kMaxFileBytes));
  auto groups = ParseRedisGroups(text, password);
  if (groups.ok()) return groups;
  return absl::Status(groups.status().code(), absl::StrCat(file, ": ", groups.status().message()));
}

}  // namespace evpose::server
