// The sending half of a Track stream: a thread that takes chunks from the source, keeps pace and credit, and writes.
// Internal: it includes generated headers.
#pragma once

#include <grpcpp/support/sync_stream.h>

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>

#include "absl/status/status.h"
#include "client/lib/pacer.h"
#include "client/lib/track.h"
#include "evpose/v1/sessions.pb.h"

namespace evpose::client {

class Uplink {
 public:
  using Stream = grpc::ClientReaderWriterInterface<v1::TrackRequest, v1::TrackResponse>;

  // `cancel` ends the call from any thread: what the uplink does when it cannot go on. The arguments must outlive it.
  Uplink(Stream& stream, const ChunkSource& source, const TrackOptions& options, std::function<void()> cancel);
  ~Uplink();  // Stop()

  // Sends `end` after the source's last chunk. Call once, when the server has answered `attached`.
  void Start(uint64_t next_seq, uint64_t send_limit_bytes, uint32_t max_chunk_bytes);
  void GrantCredit(uint64_t send_limit_bytes);
  // Wakes the thread wherever it waits and joins it. Idempotent.
  void Stop();

  // Why it gave up, OK otherwise. After Stop().
  const absl::Status& status() const { return status_; }
  uint64_t sent_bytes() const { return sent_bytes_; }
  uint64_t sent_chunks() const { return sent_chunks_; }

 private:
  void Run(uint64_t next_seq, size_t max_piece_bytes);
  bool SendChunk(const EventChunkBytes& chunk, size_t max_piece_bytes, uint64_t& next_seq);
  bool WaitForCredit(size_t size);

  Stream& stream_;
  const ChunkSource& source_;
  const TrackOptions& options_;
  const std::function<void()> cancel_;
  Pacer pacer_;
  std::stop_source stop_;

  std::mutex mutex_;
  std::condition_variable_any credit_changed_;
  uint64_t send_limit_bytes_ = 0;  // guarded by mutex_

  std::atomic<uint64_t> sent_bytes_ = 0;
  std::atomic<uint64_t> sent_chunks_ = 0;
  absl::Status status_;
  std::jthread thread_;
};

}  // namespace evpose::client
