// SPDX-License-Identifier: Apache-2.0

// The sending half of a Track stream: a thread that reads chunks from the outbox, observes its credit, and writes; and
// one that writes empty chunks while the source has no events. Internal: it includes generated headers.
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
#include "absl/time/time.h"
#include "client/lib/stream/outbox.h"
#include "evpose/v1/session_service.pb.h"

namespace evpose::client {

class Uplink {
 public:
  using Stream = grpc::ClientReaderWriterInterface<v1::TrackRequest, v1::TrackResponse>;

  // `cancel` ends the call from any thread; the uplink calls it when it cannot continue, also if the server raises the
  // limit of the credit for no chunk within `credit_timeout`. The arguments must outlive it.
  Uplink(Stream& stream, Outbox& outbox, bool has_checksum, absl::Duration credit_timeout,
         std::function<void()> cancel);
  ~Uplink();  // calls Stop()

  // Sends the chunks from this one on, and `end` after the last. Until then no third of `idle_timeout`, at least 10 ms,
  // passes without a message; zero: unlimited. To be called once, after `attached`.
  void Start(uint64_t next_seq, uint64_t send_limit_bytes, absl::Duration idle_timeout);
  void GrantCredit(uint64_t send_limit_bytes);
  // Stops sending and half-closes the stream without `end`: the server finishes the received data.
  void Leave();
  // Wakes the thread and joins it. Idempotent.
  void Stop();

  // The cause of its failure, otherwise OK. Valid after Stop().
  const absl::Status& status() const { return status_; }
  // Position in the feed after the last sent chunk.
  uint64_t fed_bytes() const { return fed_bytes_; }
  // Number of the last chunk or reset that was sent on this stream, or before it. Valid after Start().
  uint64_t sent_seq() const { return sent_seq_; }

 private:
  void Run(uint64_t next_seq, absl::Duration idle_timeout);
  // Returns true if all chunks were sent.
  bool SendChunks(uint64_t next_seq);
  // Returns false if the stream is over or must be left.
  bool Send(const OutgoingChunk& chunk);
  bool WaitForCredit(size_t size);
  bool Write(const v1::TrackRequest& request);
  void KeepAlive(absl::Duration period, const std::stop_token& stop);
  void Fail(const absl::Status& status);

  Stream& stream_;
  Outbox& outbox_;
  const bool has_checksum_;
  const absl::Duration credit_timeout_;
  const std::function<void()> cancel_;
  std::stop_source stop_;
  std::atomic<bool> is_leaving_ = false;

  std::mutex mutex_;
  std::condition_variable_any credit_changed_;
  uint64_t send_limit_bytes_ = 0;  // guarded by mutex_

  std::mutex write_mutex_;
  bool has_written_ = false;  // since the last check of KeepAlive(); guarded by write_mutex_

  uint64_t sent_bytes_ = 0;  // on this stream
  std::atomic<uint64_t> fed_bytes_ = 0;
  std::atomic<uint64_t> sent_seq_ = 0;
  absl::Status status_;
  std::jthread thread_;
};

}  // namespace evpose::client
