// SPDX-License-Identifier: Apache-2.0

// The common part of the encoders: checks of times and addresses, vectors.
#pragma once

#include <cstdint>
#include <cstring>
#include <memory>
#include <optional>
#include <vector>

#include "core/events/encoder.h"

namespace evpose {

// The period of TIME_HIGH of a camera, so that a reader that starts in the middle soon has the time.
inline constexpr int64_t kTimeWordPeriodUs = 16;
// The times that an encoder accepts. A gap above 30 days is a mistake, such as two mixed clocks; the limit also bounds
// the number of words for a gap.
struct TimeLimits {
  int64_t max_first_us = int64_t{30} * 24 * 3600 * 1000000;
  int64_t max_gap_us = max_first_us;
  bool has_time_words = true;  // false: each word has a whole time, and times may step back by max_gap_us
  int num_trigger_inputs = 0;  // with numbers from 0; 0: the encoding has no triggers
};
// Pixels of a vector, neighbours in a row.
inline constexpr int kVectorPixels = 32;

template <typename Word>
void AppendWord(Word word, std::vector<uint8_t>& out) {
  const size_t size = out.size();
  out.resize(size + sizeof(Word));
  std::memcpy(out.data() + size, &word, sizeof(Word));
}

// Checks all times and addresses of a call before it writes.
class WordEncoder : public EventEncoder {
 public:
  absl::Status Encode(absl::Span<const Event> events, std::vector<uint8_t>& out) final;
  absl::Status EncodeTime(int64_t t_us, std::vector<uint8_t>& out) final;
  absl::Status EncodeTrigger(const Trigger& trigger, std::vector<uint8_t>& out) final;

 protected:
  WordEncoder(SensorGeometry geometry, const TimeLimits& limits) : geometry_(geometry), limits_(limits) {}

  virtual void EncodeChecked(absl::Span<const Event> events, std::vector<uint8_t>& out) = 0;
  // Called only for encodings with time words.
  virtual void EncodeCheckedTime(int64_t t_us, std::vector<uint8_t>& out) = 0;
  virtual void EncodeCheckedTrigger(const Trigger& trigger, std::vector<uint8_t>& out) = 0;

  const SensorGeometry geometry_;

 private:
  absl::Status Check(absl::Span<const Event> events) const;
  // `event` is the index of the event with this time, for errors.
  absl::Status CheckOrder(std::optional<size_t> event, int64_t t_us, int64_t previous_us) const;
  absl::Status CheckGap(std::optional<size_t> event, int64_t t_us, int64_t previous_us) const;

  const TimeLimits limits_;
  int64_t last_us_ = 0;
  int64_t last_written_us_ = -1;  // -1 before the first
};

// The number of leading events that fit into one vector: the same time, row, polarity and aligned group of 32 columns,
// from left to right, because a mask has no other order.
size_t VectorRunLength(absl::Span<const Event> events);
// The mask of a run: bit i is the pixel i columns right of the aligned base.
uint32_t VectorMask(absl::Span<const Event> run);

std::unique_ptr<EventEncoder> MakeEvt3Encoder(SensorGeometry geometry);
std::unique_ptr<EventEncoder> MakeEvt21Encoder(SensorGeometry geometry);
std::unique_ptr<EventEncoder> MakeEvt2Encoder(SensorGeometry geometry);
std::unique_ptr<EventEncoder> MakeDatEncoder(SensorGeometry geometry);
std::unique_ptr<EventEncoder> MakeFlat64Encoder(SensorGeometry geometry);

}  // namespace evpose
