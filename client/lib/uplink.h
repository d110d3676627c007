// SPDX-License-Identifier: Apache-2.0

// The sending half of a Track stream: a thread that takes chunks from the outbox, keeps to its credit, and writes.
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
#include "client/lib/outbox.h"
#include "evpose/v1/session_service.pb.h"

namespace evpose::client {

class Uplink {
 public:
  using Stream = grpc::ClientReaderWriterInterface<v1::TrackRequest, v1::TrackResponse>;

  // `cancel` ends the call from any thread: what the uplink does when it cannot go on. The arguments must outlive it.
  Uplink(Stream& stream, Outbox& outbox, bool has_checksum, std::function<void()> cancel);
  ~Uplink();  // Stop()

  // Sends the chunks from this one on, `end` after the last. Call once, when the server has answered `attached`.
  void Start(uint64_t next_seq, uint64_t send_limit_bytes);
  void GrantCredit(uint64_t send_limit_bytes);
  // Sends no more and half-closes the stream, without `end`: the server finishes what it has.
  void Leave();
  // Wakes the thread wherever it waits and joins it. Idempotent.
  void Stop();

  // Why it gave up, OK otherwise. After Stop().
  const absl::Status& status() const { return status_; }
  // Of the feed, up to the last chunk sent.
  uint64_t fed_bytes() const { return fed_bytes_; }

 private:
  void Run(uint64_t next_seq);
  // False when the stream is over or to be left.
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
