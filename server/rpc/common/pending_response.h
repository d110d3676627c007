// SPDX-License-Identifier: Apache-2.0

// Bounds the memory of responses that clients do not read, for calls with one response. gRPC keeps the message and its
// serialized bytes until the client reads them, and a client may grant no window of HTTP/2 for that.
#pragma once

#include <google/protobuf/message.h>
#include <grpcpp/server_context.h>

#include <memory>
#include <mutex>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "server/rpc/common/call_alarm.h"
#include "server/sessions/tenant_quotas.h"

namespace evpose::server {

struct ResponseLimits {
  TenantQuotas& quotas;
  absl::Duration timeout;  // from the end of the work until the client has taken the response
};

// The response of one call. The call keeps it until OnDone().
class PendingResponse : public std::enable_shared_from_this<PendingResponse> {
 public:
  PendingResponse(const ResponseLimits& limits, grpc::CallbackServerContext& context)
      : limits_(limits), context_(&context) {}

  // Counts the bytes of the response for the tenant, and cancels the call if it has not ended in time. To be called at
  // most once, before the call is finished with OK. Errors: RESOURCE_EXHAUSTED (TENANT_QUOTA), the message is
  // then empty; RESOURCE_EXHAUSTED (OUT_OF_MEMORY). The call is then to be finished with this error.
  absl::Status Begin(const std::string& tenant, google::protobuf::Message& response);
  // To be called in OnDone(): the response was sent, or the call was cancelled.
  void End();

 private:
  void OnAlarm();

  const ResponseLimits limits_;
  // Set by Begin(), which precedes the end of the call.
  std::shared_ptr<const void> reservation_;
  CallAlarm alarm_;
  // gRPC may call OnDone() while TryCancel() runs, on the same thread.
  std::recursive_mutex mutex_;
  grpc::CallbackServerContext* context_ ABSL_GUARDED_BY(mutex_);  // null after End()
};

}  // namespace evpose::server
