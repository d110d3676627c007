// SPDX-License-Identifier: Apache-2.0

// Converts absl::Status to grpc::Status, with google.rpc details in grpc-status-details-bin. No other file does.
#pragma once

#include <grpcpp/support/status.h>

#include "absl/status/status.h"

namespace evpose::server {

// Adds the details that the status has (server/runtime/errors.h): BadRequest with the invalid field, ErrorInfo with the
// reason, QuotaFailure and RetryInfo for limits. If memory is exhausted, only the code remains, so that a call that
// ends for this reason is finished.
grpc::Status ToGrpcStatus(const absl::Status& status) noexcept;

}  // namespace evpose::server
