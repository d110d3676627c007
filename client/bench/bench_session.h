// SPDX-License-Identifier: Apache-2.0

// Sessions fed from memory, for benchmarks.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/events/recording_reader.h"
#include "core/experiments/speed/speed_recordings.h"
#include "evpose/client.h"

namespace evpose::client {

// A recording as its file has it. Copies share the bytes.
struct EncodedRecording {
  Encoding encoding = Encoding::kEvt3;
  SensorGeometry geometry;
  std::shared_ptr<const std::vector<uint8_t>> bytes;
};

// The bytes in memory, as often as they are to come.
class MemoryReader final : public RecordingReader {
 public:
  MemoryReader(const EncodedRecording& recording, int num_times = 1);

  const RecordingHeader& header() const override { return header_; }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override;
  int64_t data_size_bytes() const override { return static_cast<int64_t>(recording_.bytes->size()) * num_times_; }

 private:
  const EncodedRecording recording_;
  const int num_times_;
  RecordingHeader header_;
  int time_ = 0;
  size_t begin_ = 0;
};

// When a pose came.
struct Arrival {
  int64_t t_us = 0;  // that it is for
  absl::Time at;     // by SystemClock()
  absl::Duration server_latency;
};

// A stream's chunks and poses in time.
struct StreamTimes {
  absl::Time begin;                    // when the first chunk could be sent; with a pace: the time of its end
  absl::Time end;                      // when the summary had come
  std::vector<int64_t> chunk_ends_us;  // the sensor's time at the end of each chunk
  std::vector<Arrival> poses;
};

struct BenchSessionOptions {
  double rate = 0.0;                   // as FeedOptions::rate
  std::function<bool()> is_cancelled;  // asked before each chunk; may be null
  StreamTimes* times = nullptr;        // filled in when it is there
};

// The configuration in which a server tracks the recording's object from its true first pose. Uploads the model.
absl::StatusOr<SessionConfig> UploadSession(Client& client, const SpeedRecording& recording, Encoding encoding);

// A session on a server, for as long as this lives. It is made before a measurement begins, because that takes longer
// than a short recording.
class BenchSession {
 public:
  // Errors: those of Client::CreateSession.
  static absl::StatusOr<std::unique_ptr<BenchSession>> Create(Client& client, const SessionConfig& config);
  ~BenchSession();  // deletes it
  BenchSession(const BenchSession&) = delete;
  BenchSession& operator=(const BenchSession&) = delete;

  // Once: the recording in chunks of 1 ms or 256 KiB, as evpose replay sends it, to the summary. A break of the stream
  // is an error. Errors: the server's; CANCELLED; INTERNAL when not `num_events` were decoded, or no pose came.
  absl::Status Stream(const EncodedRecording& recording, uint64_t num_events, const BenchSessionOptions& options);

 private:
  BenchSession(Client& client, Session session) : client_(client), session_(std::move(session)) {}

  Client& client_;
  const Session session_;
};

}  // namespace evpose::client
