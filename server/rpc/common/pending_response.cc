// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/common/pending_response.h"

#include <utility>

namespace evpose::server {
namespace {

// What a call takes beside its messages: gRPC's own objects.
constexpr uint64_t kCallBytes = 16u << 10;

}  // namespace

absl::Status PendingResponse::Begin(const std::string& tenant, google::protobuf::Message& response) {
  auto reservation =
      limits_.quotas.AddResponse(tenant, kCallBytes + response.SpaceUsedLong() + response.ByteSizeLong());
  if (!reservation.ok()) {
    // Clear() would keep the memory until the call has ended.
    const std::unique_ptr<google::protobuf::Message> empty(response.New());
    response.GetReflection()->Swap(&response, empty.get());
    return reservation.status();
  }
  reservation_ = *std::move(reservation);
  return alarm_.Set(limits_.timeout, [weak = weak_from_this()] {
    const auto self = weak.lock();
    if (self != nullptr) self->OnAlarm();
  });
}

void PendingResponse::OnAlarm() {
  const std::lock_guard lock(mutex_);
  if (context_ != nullptr) context_->TryCancel();
}

void PendingResponse::End() {
  const std::lock_guard lock(mutex_);
  context_ = nullptr;
  alarm_.Cancel();
  reservation_.reset();
}

}  // namespace evpose::server
