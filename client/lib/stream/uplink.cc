// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/uplink.h"

#include <algorithm>
#include <memory>
#include <utility>

namespace evpose::client {

Uplink::Uplink(Stream& stream, Outbox& outbox, bool has_checksum, std::function<void()> cancel)
    : stream_(stream), outbox_(outbox), has_checksum_(has_checksum), cancel_(std::move(cancel)) {}

Uplink::~Uplink() { Stop(); }

void Uplink::Start(uint64_t next_seq, uint64_t send_limit_bytes) {
  GrantCredit(send_limit_bytes);
  thread_ = std::jthread([this, next_seq] { Run(next_seq); });
}

void Uplink::GrantCredit(uint64_t send_limit_bytes) {
  {
    std::lock_guard lock(mutex_);
    send_limit_bytes_ = std::max(send_limit_bytes_, send_limit_bytes);
  }
  credit_changed_.notify_all();
}

void Uplink::Leave() {
  is_leaving_ = true;
  stop_.request_stop();
}

void Uplink::Stop() {
  stop_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void Uplink::Run(uint64_t next_seq) {
  for (uint64_t seq = next_seq; !stop_.stop_requested(); ++seq) {
    const absl::StatusOr<std::shared_ptr<const OutgoingChunk>> chunk = outbox_.Get(seq, stop_.get_token());
    if (stop_.stop_requested()) break;
    if (!chunk.ok()) return Fail(chunk.status());
    if (*chunk == nullptr) {
      v1::TrackRequest request;
      request.mutable_end();
      if (stream_.Write(request)) stream_.WritesDone();
      return;
    }
    if (!Send(**chunk)) break;
  }
  if (is_leaving_) stream_.WritesDone();
}

bool Uplink::Send(const OutgoingChunk& chunk) {
  v1::TrackRequest request;
  if (chunk.is_reset) {  // uses no credit
    if (!request.mutable_reset_pose()->ParseFromString(chunk.payload)) {
      Fail(absl::DataLossError("a stored reset of a pose cannot be read"));
      return false;
    }
    request.mutable_reset_pose()->set_seq(chunk.end.seq);
    return stream_.Write(request);
  }
  if (!WaitForCredit(chunk.payload.size())) return false;
  v1::TrackRequest::EventChunk& events = *request.mutable_events();
  events.set_seq(chunk.end.seq);
  events.set_discontinuity(chunk.discontinuity);
  events.set_payload(chunk.payload);
  if (has_checksum_) events.set_crc32c(chunk.crc32c);
  if (!stream_.Write(request)) return false;  // the stream has ended; Finish() returns its status
  sent_bytes_ += chunk.payload.size();
  fed_bytes_ = chunk.end.bytes;
  return true;
}

bool Uplink::WaitForCredit(size_t size) {
  std::unique_lock lock(mutex_);
  return credit_changed_.wait(lock, stop_.get_token(),
                              [this, size] { return sent_bytes_ + size <= send_limit_bytes_; });
}

void Uplink::Fail(const absl::Status& status) {
  status_ = status;
  cancel_();
}

}  // namespace evpose::client
