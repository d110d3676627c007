// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/standard_methods.h"

#include <algorithm>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

constexpr size_t kDefaultPageSize = 50;  // as the API states
constexpr size_t kMaxPageSize = 1000;    // bounds the memory of one response

}  // namespace

absl::Status DeletionStatus(const absl::Status& status, bool allow_missing) {
  return allow_missing && absl::IsNotFound(status) ? absl::OkStatus() : status;
}

absl::StatusOr<size_t> PageSize(int32_t page_size) {
  if (page_size < 0) return InvalidField("page_size", absl::StrCat("is ", page_size, "; it must not be below 0"));
  return page_size == 0 ? kDefaultPageSize : std::min(static_cast<size_t>(page_size), kMaxPageSize);
}

absl::StatusOr<std::string> PageStart(const std::string& page_token, const std::string& prefix) {
  if (page_token.empty() || absl::StartsWith(page_token, prefix)) return page_token;
  return InvalidField("page_token",
                      "is not a next_page_token of this list: give the next_page_token of the previous response, or "
                      "leave it empty for the first page");
}

}  // namespace evpose::server
