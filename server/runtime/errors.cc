// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/errors.h"

#include <algorithm>
#include <optional>

#include "absl/strings/cord.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"

namespace evpose::server {
namespace {

constexpr absl::string_view kField = "evpose.v1/field";
constexpr absl::string_view kReason = "evpose.v1/reason";
constexpr absl::string_view kQuotaSubject = "evpose.v1/quota_subject";
constexpr absl::string_view kRetryMs = "evpose.v1/retry_ms";
constexpr absl::string_view kMetadataPrefix = "evpose.v1/metadata/";

void SetPayload(absl::Status& status, absl::string_view key, absl::string_view value) {
  status.SetPayload(key, absl::Cord(value));
}

std::string GetPayload(const absl::Status& status, absl::string_view key) {
  const auto payload = status.GetPayload(key);
  return payload.has_value() ? std::string(*payload) : std::string();
}

}  // namespace

absl::Status InvalidField(absl::string_view field, absl::string_view description) {
  absl::Status status = absl::InvalidArgumentError(absl::StrCat(field, ": ", description));
  SetPayload(status, kField, field);
  return status;
}

absl::Status WithReason(absl::Status status, v1::ErrorReason reason,
                        std::initializer_list<std::pair<absl::string_view, std::string>> metadata) {
  SetPayload(status, kReason, v1::ErrorReason_Name(reason));
  for (const auto& [key, value] : metadata) SetPayload(status, absl::StrCat(kMetadataPrefix, key), value);
  return status;
}

absl::Status LimitReached(v1::ErrorReason reason, absl::string_view subject, absl::string_view description,
                          absl::Duration retry_after) {
  absl::Status status = WithReason(absl::ResourceExhaustedError(description), reason);
  SetPayload(status, kQuotaSubject, subject);
  if (retry_after > absl::ZeroDuration()) {
    SetPayload(status, kRetryMs, absl::StrCat(absl::ToInt64Milliseconds(retry_after)));
  }
  return status;
}

absl::Status FromStore(const absl::Status& status) {
  const ErrorDetails details = GetErrorDetails(status);
  if (status.ok() || !details.reason.empty() || !details.field.empty()) return status;
  switch (status.code()) {
    case absl::StatusCode::kCancelled:  // the caller no longer waits
      return status;
    case absl::StatusCode::kUnavailable:
      return WithReason(absl::UnavailableError(absl::StrCat("the store does not respond: ", status.message())),
                        v1::STORE_UNAVAILABLE);
    case absl::StatusCode::kResourceExhausted:
      return WithReason(absl::ResourceExhaustedError(absl::StrCat("the store has no room: ", status.message())),
                        v1::STORE_FULL);
    default:
      return WithReason(absl::InternalError(absl::StrCat("the store failed: ", status.message())), v1::STORE_FAILED);
  }
}

ErrorDetails GetErrorDetails(const absl::Status& status) {
  ErrorDetails details;
  details.field = GetPayload(status, kField);
  details.reason = GetPayload(status, kReason);
  details.quota_subject = GetPayload(status, kQuotaSubject);
  int64_t retry_ms = 0;
  if (absl::SimpleAtoi(GetPayload(status, kRetryMs), &retry_ms)) details.retry_after = absl::Milliseconds(retry_ms);
  status.ForEachPayload([&details](absl::string_view key, const absl::Cord& value) {
    if (absl::ConsumePrefix(&key, kMetadataPrefix)) details.metadata.emplace_back(std::string(key), std::string(value));
  });
  std::sort(details.metadata.begin(), details.metadata.end());
  return details;
}

}  // namespace evpose::server
