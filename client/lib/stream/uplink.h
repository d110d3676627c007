// SPDX-License-Identifier: Apache-2.0

// The sending half of a Track stream: a thread that reads chunks from the outbox, observes its credit, and writes.
// Internal: it includes generated headers.
#pragma once

#include <grpcpp/support/sync_stream.h>

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <stop_token>
#include <thread>

#include "absl/status/status.h"
#include "client/lib/stream/outbox.h"
#include "evpose/v1/session_service.pb.h"

namespace evpose::client {

class Uplink {
 public:
  using Stream = grpc::ClientReaderWriterInterface<v1::TrackRequest, v1::TrackResponse>;

  // `cancel` ends the call from any thread; the uplink calls it when it cannot continue. The arguments must outlive it.
  Uplink(Stream& stream, Outbox& outbox, bool has_checksum, std::function<void()> cancel);
  ~Uplink();  // calls Stop()

  // Sends the chunks from this one on, and `end` after the last. To be called once, after `attached`.
  void Start(uint64_t next_seq, uint64_t send_limit_bytes);
  void GrantCredit(uint64_t send_limit_bytes);
  // Stops sending and half-closes the stream without `end`: the server finishes the received data.
  void Leave();
  // Wakes the thread and joins it. Idempotent.
  void Stop();

  // The cause of its failure, otherwise OK. Valid after Stop().
  const absl::Status& status() const { return status_; }
  // Position in the feed after the last sent chunk.
  uint64_t fed_bytes() const { return fed_bytes_; }

 private:
  void Run(uint64_t next_seq);
  // Returns false if the stream is over or must be left.
  bool Send(const OutgoingChunk& chunk);
  bool WaitForCredit(size_t size);
  void Fail(const absl::Status& status);

  Stream& stream_;
  Outbox& outbox_;
  const bool has_checksum_;
  const std::function<void()> cancel_;
  std::stop_source stop_;
  std::atomic<bool> is_leaving_ = false;

  std::mutex mutex_;
  std::condition_variable_any credit_changed_;
  uint64_t send_limit_bytes_ = 0;  // guarded by mutex_

  uint64_t sent_bytes_ = 0;  // on this stream
  std::atomic<uint64_t> fed_bytes_ = 0;
  absl::Status status_;
  std::jthread thread_;
};

}  // namespace evpose::client
