// SPDX-License-Identifier: Apache-2.0

// The bytes that a client may send on one stream (backpressure).
#pragma once

#include <algorithm>
#include <cstdint>

#include "server/sessions/types/session_config.h"

namespace evpose::server {

// Not thread-safe. The limit is absolute, in bytes since the stream attached, so that a lost or repeated ack does no
// harm.
class ByteCredit {
 public:
  ByteCredit(uint64_t credit_bytes, OverloadPolicy policy) : credit_bytes_(credit_bytes), policy_(policy) {}

  // Starts counting for a new stream. `queued_bytes` of earlier streams still occupy the queue.
  void StartStream(uint64_t queued_bytes) {
    received_bytes_ = 0;
    processed_bytes_ = 0;
    earlier_bytes_ = queued_bytes;
  }
  void AddReceived(uint64_t bytes) { received_bytes_ += bytes; }
  // `is_of_stream` is true if the bytes came from the current stream, not from an earlier one.
  void AddProcessed(uint64_t bytes, bool is_of_stream) {
    if (is_of_stream) {
      processed_bytes_ += bytes;
    } else {
      earlier_bytes_ -= std::min(bytes, earlier_bytes_);
    }
  }

  // With kBlock the client waits until its bytes have been processed. With kLatest it does not wait, because a camera
  // cannot: received bytes no longer occupy the network, and the session bounds its queue by reading no more
  // (StreamView::has_room).
  uint64_t SendLimit() const {
    if (policy_ == OverloadPolicy::kLatest) return received_bytes_ + credit_bytes_;
    return processed_bytes_ + credit_bytes_ - std::min(earlier_bytes_, credit_bytes_);
  }

 private:
  const uint64_t credit_bytes_;
  const OverloadPolicy policy_;
  uint64_t received_bytes_ = 0;   // bytes of this stream
  uint64_t processed_bytes_ = 0;  // bytes of this stream, including repeated chunks, which are dropped
  uint64_t earlier_bytes_ = 0;    // queued by earlier streams
};

}  // namespace evpose::server
