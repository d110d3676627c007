// SPDX-License-Identifier: Apache-2.0

// The one place where our errors become gRPC's, with google.rpc details in grpc-status-details-bin.
#pragma once

#include <grpcpp/support/status.h>

#include "absl/status/status.h"

namespace evpose::server {

// BadRequest for a field that is to blame, else ErrorInfo with the reason; QuotaFailure and RetryInfo for limits.
grpc::Status ToGrpcStatus(const absl::Status& status);

}  // namespace evpose::server
