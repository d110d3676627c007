// SPDX-License-Identifier: Apache-2.0

// Sessions that stream a recording from memory, for benchmarks.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/experiments/speed/speed_recordings.h"
#include "core/recordings/recording_reader.h"
#include "evpose/client.h"

namespace evpose::client {

// The encoded bytes of a recording. Copies share them.
struct EncodedRecording {
  Encoding encoding = Encoding::kEvt3;
  SensorGeometry geometry;
  std::shared_ptr<const std::vector<uint8_t>> bytes;
};

// Reads the bytes from memory, `num_times` times one after the other.
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

// The arrival of a pose at the client.
struct Arrival {
  int64_t t_us = 0;  // time of the pose on the sensor's clock
  absl::Time at;     // time of arrival by SystemClock()
  absl::Duration server_latency;
};

// Times of the chunks and poses of a stream.
struct StreamTimes {
  absl::Time begin;                    // start of the stream; with a rate, the time of the end of the first chunk
  absl::Time end;                      // arrival of the summary
  std::vector<int64_t> chunk_ends_us;  // sensor time at the end of each chunk
  std::vector<Arrival> poses;
};

// Uploads the model and returns the configuration of a session that tracks the object of the recording from its true
// first pose.
absl::StatusOr<SessionConfig> UploadSession(Client& client, const SpeedRecording& recording, Encoding encoding);

// A session on a server, deleted by the destructor. It is created before a measurement starts, because its creation
// takes longer than a short recording.
class BenchSession {
 public:
  // Errors: those of Client::CreateSession.
  static absl::StatusOr<std::unique_ptr<BenchSession>> Create(Client& client, const SessionConfig& config);
  ~BenchSession();
  BenchSession(const BenchSession&) = delete;
  BenchSession& operator=(const BenchSession&) = delete;

  // Streams the recording in chunks of 1 ms or 256 KiB, as evpose replay does, and waits for the summary. To be called
  // once. Does not reconnect. Errors: those of the server; CANCELLED; INTERNAL if the server did not decode
  // `num_events` events or returned no pose. `rate`: as FeedOptions::rate; `is_cancelled` is called before each chunk.
  absl::StatusOr<StreamTimes> Stream(const EncodedRecording& recording, uint64_t num_events, double rate,
                                     const std::function<bool()>& is_cancelled);

 private:
  BenchSession(Client& client, Session session) : client_(client), session_(std::move(session)) {}

  Client& client_;
  const Session session_;
};

}  // namespace evpose::client
