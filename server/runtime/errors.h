// SPDX-License-Identifier: Apache-2.0

// Errors with details that a program can test. The details are payloads of absl::Status, so that nothing below
// server/rpc depends on gRPC; server/rpc/common/status_mapping.h turns them into google.rpc messages.
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

// Returns INVALID_ARGUMENT. `field` is the path in the request (config.camera.width_px), `description` explains why its
// value is invalid.
absl::Status InvalidField(absl::string_view field, absl::string_view description);

// Adds a reason that a program may test, and its metadata.
absl::Status WithReason(absl::Status status, v1::ErrorReason reason,
                        std::initializer_list<std::pair<absl::string_view, std::string>> metadata = {});

// The delay that RetryInfo suggests to a client when the server is full: other sessions or streams may have ended by
// then.
inline constexpr absl::Duration kRetryDelay = absl::Seconds(5);

// Returns RESOURCE_EXHAUSTED. `subject` is the name of the limit. A `retry_after` of zero means that waiting does not
// help; then no RetryInfo is sent.
absl::Status LimitReached(v1::ErrorReason reason, absl::string_view subject, absl::string_view description,
                          absl::Duration retry_after);

// Translates a status of a store into the status that clients see: UNAVAILABLE gets the reason STORE_UNAVAILABLE,
// RESOURCE_EXHAUSTED gets STORE_FULL, every other error becomes INTERNAL with STORE_FAILED. OK, and a status that
// already has a reason or a field, is returned unchanged.
absl::Status FromStore(const absl::Status& status);

struct ErrorDetails {
  std::string field;                                          // empty: the error is not about a field
  std::string reason;                                         // name of a v1::ErrorReason; empty: none
  std::vector<std::pair<std::string, std::string>> metadata;  // sorted by key
  std::string quota_subject;
  absl::Duration retry_after;
};
// Reads the details that the functions above have attached; members without a detail are empty.
ErrorDetails GetErrorDetails(const absl::Status& status);

}  // namespace evpose::server
