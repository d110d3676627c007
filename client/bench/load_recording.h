// SPDX-License-Identifier: Apache-2.0

// A recording without an end, for load tests: encoded once, and shared by all sessions.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "core/experiments/speed/speed_recordings.h"

namespace evpose::client {

// A simulated scene of the speed benchmark that is repeated forwards and backwards, in EVT3. An object on its way back
// gives the same events in reverse order with the opposite polarity, so that the motion has no jump. Sensor time is
// stretched until the rate of events is the one that was asked for.
//
// A period is a multiple of 4096 us, the unit of EVT3's TIME_HIGH: a repetition differs from the first period in the
// contents of these words alone, and Payload() changes nothing else.
class LoadRecording {
 public:
  static constexpr double kMinRateHz = 1e3;
  static constexpr double kMaxRateHz = 1e7;  // of the fastest scene that a tracker follows without a lamp that flickers
  static constexpr int64_t kMaxChunkUs = 20'000;

  // Simulates at least a quarter of a second at `rate_hz` events per second, and encodes it in chunks of `chunk_us` of
  // sensor time. `on_progress` is called with the finished share and may be null. Errors: INVALID_ARGUMENT for a rate
  // or chunk outside its limits; CANCELLED if `on_progress` returns false.
  static absl::StatusOr<LoadRecording> Make(double rate_hz, int64_t chunk_us,
                                            const std::function<bool(double)>& on_progress = nullptr);

  // The payload of a chunk: sensor time [number * chunk_us, (number + 1) * chunk_us).
  std::string Payload(uint64_t number) const;
  uint64_t NumEvents(uint64_t number) const { return chunks_[number % chunks_.size()].num_events; }

  int64_t chunk_us() const { return chunk_us_; }
  int64_t period_us() const { return chunk_us_ * static_cast<int64_t>(chunks_.size()); }
  // Model, camera and first pose of the scene; without its events.
  const SpeedRecording& scene() const { return scene_; }

 private:
  struct Chunk {
    size_t begin = 0, end = 0;              // of bytes_
    size_t highs_begin = 0, highs_end = 0;  // of highs_
    uint64_t num_events = 0;
  };

  // Divides the events of one period into chunks and encodes them.
  absl::Status Encode(const std::vector<Event>& events, size_t num_chunks);

  SpeedRecording scene_;
  int64_t chunk_us_ = 0;
  std::vector<Chunk> chunks_;
  std::vector<uint8_t> bytes_;
  std::vector<size_t> highs_;  // positions of the TIME_HIGH words in bytes_
};

}  // namespace evpose::client
