// SPDX-License-Identifier: Apache-2.0

// Errors with details that a program can test. The details are payloads of absl::Status, so that nothing below
// server/rpc depends on gRPC; server/rpc/status_mapping.h turns them into google.rpc messages.
#pragma once

#include <initializer_list>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "evpose/v1/error_reason.pb.h"

namespace evpose::server {

// INVALID_ARGUMENT: `field` is the path in the request (config.camera.width_px), `description` what is wrong with it.
absl::Status InvalidField(absl::string_view field, absl::string_view description);

// Adds a reason that a program may test, and its metadata.
absl::Status WithReason(absl::Status status, v1::ErrorReason reason,
                        std::initializer_list<std::pair<absl::string_view, std::string>> metadata = {});

// When others may have gone.
inline constexpr absl::Duration kRetryDelay = absl::Seconds(5);

// RESOURCE_EXHAUSTED: `subject` is the limit's name; retry_after zero: waiting does not help.
absl::Status LimitReached(v1::ErrorReason reason, absl::string_view subject, absl::string_view description,
                          absl::Duration retry_after);

// What a store answered, for its clients: UNAVAILABLE (STORE_AWAY), RESOURCE_EXHAUSTED (STORE_FULL), else INTERNAL
// (STORE_FAILED). OK, and what has a reason or a field already, as it is.
absl::Status FromStore(const absl::Status& status);

struct ErrorDetails {
  std::string field;                                          // empty: no field is to blame
  std::string reason;                                         // name of a v1::ErrorReason; empty: none
  std::vector<std::pair<std::string, std::string>> metadata;  // in the order of the keys
  std::string quota_subject;
  absl::Duration retry_after;
};
ErrorDetails GetErrorDetails(const absl::Status& status);

}  // namespace evpose::server
