// SPDX-License-Identifier: Apache-2.0
#include "client/bench/load_recording.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <numeric>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/events/encoder.h"

namespace evpose::client {
namespace {

constexpr int64_t kTimeHighUnitUs = 4096;
constexpr uint16_t kTimeHighType = 0x8;  // in the highest four bits of a word
// Seconds. With a shorter period the motion would turn back so often that the views would hardly differ.
constexpr double kLeastSimulatedS = 0.25;

// Returns the slowest scene that has at least this rate. Time is then stretched and never compressed, so that the
// object does not move faster than the tracker can follow.
std::pair<const char*, double> SceneFor(double rate_hz) {
  if (rate_hz <= 1e6) return {"1", 1e6};
  if (rate_hz <= 4e6) return {"4", 4e6};
  return {"10", 1e7};
}

// Returns the first `num` events, stretched to `half_us`, followed by the same events backwards in as much time.
std::vector<Event> Fold(const std::vector<Event>& events, size_t num, int64_t half_us) {
  const int64_t begin_us = events.front().t_us;
  const double stretch = static_cast<double>(half_us) / static_cast<double>(events[num - 1].t_us + 1 - begin_us);
  std::vector<Event> folded;
  folded.reserve(2 * num);
  for (size_t i = 0; i < num; ++i) {
    Event event = events[i];
    event.t_us = std::min(half_us - 1, static_cast<int64_t>(stretch * static_cast<double>(event.t_us - begin_us)));
    folded.push_back(event);
  }
  for (size_t i = num; i-- > 0;) {
    Event event = folded[i];
    event.t_us = 2 * half_us - 1 - event.t_us;
    event.polarity = event.polarity == 0 ? 1 : 0;
    folded.push_back(event);
  }
  // Within a microsecond, a sensor sends events in the order of rows. Only then do events form vectors.
  const auto is_before = [](const Event& a, const Event& b) {
    return std::tie(a.t_us, a.y, a.polarity, a.x) < std::tie(b.t_us, b.y, b.polarity, b.x);
  };
  std::sort(folded.begin(), folded.end(), is_before);
  return folded;
}

}  // namespace

absl::StatusOr<LoadRecording> LoadRecording::Make(double rate_hz, int64_t chunk_us,
                                                  const std::function<bool(double)>& on_progress) {
  if (!(rate_hz >= kMinRateHz && rate_hz <= kMaxRateHz)) {
    return absl::InvalidArgumentError(
        absl::StrCat("rate: ", rate_hz, " events per second; ", kMinRateHz, " to ", kMaxRateHz));
  }
  if (chunk_us < 1000 || chunk_us > kMaxChunkUs) {
    return absl::InvalidArgumentError(absl::StrCat("chunk: ", chunk_us, " us; 1000 to ", kMaxChunkUs));
  }
  LoadRecording recording;
  recording.chunk_us_ = chunk_us;
  // The period is a multiple of both the chunk and the unit of TIME_HIGH.
  const int64_t unit_us = std::lcm(chunk_us, kTimeHighUnitUs);
  const auto [name, scene_rate_hz] = SceneFor(rate_hz);
  const double half_unit_s = 0.5e-6 * static_cast<double>(unit_us) * rate_hz / scene_rate_hz;
  // The rate of a scene varies with its motion. 30 % more time than half of the shortest period is simulated, so that
  // there are enough events.
  const double simulated_s = std::max(kLeastSimulatedS, 1.3 * half_unit_s);
  EVPOSE_ASSIGN_OR_RETURN(recording.scene_, MakeSpeedRecording(name, std::llround(1e6 * simulated_s), on_progress));
  const std::vector<Event> events = std::move(recording.scene_.events);
  recording.scene_.events.clear();
  const double per_unit = rate_hz * 1e-6 * static_cast<double>(unit_us) / 2.0;  // events in half of the shortest period
  const auto num_units = std::max<int64_t>(1, static_cast<int64_t>(static_cast<double>(events.size()) / per_unit));
  const size_t num = std::min(events.size(), static_cast<size_t>(per_unit * static_cast<double>(num_units)));
  const int64_t period_us = num_units * unit_us;
  EVPOSE_RETURN_IF_ERROR(recording.Encode(Fold(events, num, period_us / 2), static_cast<size_t>(period_us / chunk_us)));
  return recording;
}

absl::Status LoadRecording::Encode(const std::vector<Event>& events, size_t num_chunks) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventEncoder> encoder,
                          MakeEventEncoder(Encoding::kEvt3, scene_.geometry));
  // A period begins with the complete time, because it follows another one.
  EVPOSE_RETURN_IF_ERROR(encoder->EncodeTime(0, bytes_));
  auto next = events.begin();
  for (size_t i = 0; i < num_chunks; ++i) {
    Chunk chunk = {.begin = i == 0 ? 0 : bytes_.size(), .highs_begin = highs_.size()};
    const int64_t end_us = static_cast<int64_t>(i + 1) * chunk_us_;
    const auto end = std::find_if(next, events.end(), [end_us](const Event& event) { return event.t_us >= end_us; });
    chunk.num_events = static_cast<uint64_t>(end - next);
    EVPOSE_RETURN_IF_ERROR(
        encoder->Encode(absl::MakeConstSpan(events.data() + (next - events.begin()), chunk.num_events), bytes_));
    next = end;
    // Each chunk ends with the time, as the data of a camera does, so that windows are closed on time also while few
    // events come.
    EVPOSE_RETURN_IF_ERROR(encoder->EncodeTime(end_us - 1, bytes_));
    chunk.end = bytes_.size();
    for (size_t position = chunk.begin; position < chunk.end; position += 2) {
      if (bytes_[position + 1] >> 4 == kTimeHighType) highs_.push_back(position);
    }
    chunk.highs_end = highs_.size();
    chunks_.push_back(chunk);
  }
  return absl::OkStatus();
}

std::string LoadRecording::Payload(uint64_t number) const {
  const Chunk& chunk = chunks_[number % chunks_.size()];
  std::string payload(reinterpret_cast<const char*>(bytes_.data()) + chunk.begin, chunk.end - chunk.begin);
  const uint64_t repetition = number / chunks_.size();
  if (repetition == 0) return payload;
  const uint64_t later = repetition * static_cast<uint64_t>(period_us() / kTimeHighUnitUs);
  for (size_t i = chunk.highs_begin; i < chunk.highs_end; ++i) {
    char* const bytes = payload.data() + (highs_[i] - chunk.begin);
    uint16_t word = 0;  // little-endian, as this machine
    std::memcpy(&word, bytes, sizeof(word));
    word = static_cast<uint16_t>(kTimeHighType << 12 | ((word + later) & 0xfff));
    std::memcpy(bytes, &word, sizeof(word));
  }
  return payload;
}

}  // namespace evpose::client
