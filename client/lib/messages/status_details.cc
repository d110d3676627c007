// SPDX-License-Identifier: Apache-2.0
#include "client/lib/messages/status_details.h"

#include "absl/strings/cord.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

constexpr char kReason[] = "evpose.v1/reason";
constexpr char kField[] = "evpose.v1/field";
constexpr char kFieldError[] = "evpose.v1/field_error";
constexpr char kRetryMs[] = "evpose.v1/retry_ms";

std::string Payload(const absl::Status& status, const char* key) {
  const auto payload = status.GetPayload(key);
  return payload.has_value() ? std::string(*payload) : std::string();
}

}  // namespace

void SetDetails(absl::Status& status, const StatusDetails& details) {
  if (!details.reason.empty()) status.SetPayload(kReason, absl::Cord(details.reason));
  if (!details.field.empty()) status.SetPayload(kField, absl::Cord(details.field));
  if (!details.field_error.empty()) status.SetPayload(kFieldError, absl::Cord(details.field_error));
  if (details.retry_in > absl::ZeroDuration()) {
    status.SetPayload(kRetryMs, absl::Cord(absl::StrCat(absl::ToInt64Milliseconds(details.retry_in))));
  }
}

StatusDetails GetDetails(const absl::Status& status) {
  StatusDetails details;
  details.reason = Payload(status, kReason);
  details.field = Payload(status, kField);
  details.field_error = Payload(status, kFieldError);
  int64_t retry_ms = 0;
  if (absl::SimpleAtoi(Payload(status, kRetryMs), &retry_ms)) details.retry_in = absl::Milliseconds(retry_ms);
  return details;
}

absl::Status WithMessage(const absl::Status& status, absl::string_view message) {
  absl::Status result(status.code(), message);
  SetDetails(result, GetDetails(status));
  return result;
}

}  // namespace evpose::client
