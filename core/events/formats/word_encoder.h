// SPDX-License-Identifier: Apache-2.0

// What the encoders have in common.
#pragma once

#include <cstdint>
#include <cstring>
#include <memory>
#include <optional>
#include <vector>

#include "core/events/encoder.h"

namespace evpose {

// A camera says the time in this period at least, so that a reader that starts anywhere soon knows it.
inline constexpr int64_t kTimeWordPeriod_us = 16;
// What an encoding can tell of time. A longer gap than 30 days comes from a mistake, such as mixing two clocks; the
// bound also bounds the words that a gap needs.
struct TimeLimits {
  int64_t max_first_us = int64_t{30} * 24 * 3600 * 1000000;
  int64_t max_gap_us = max_first_us;
  bool has_time_words = true;
};
// Vector words hold this many neighbours of a row.
inline constexpr int kVectorPixels = 32;

template <typename Word>
void AppendWord(Word word, std::vector<uint8_t>& out) {
  const size_t size = out.size();
  out.resize(size + sizeof(Word));
  std::memcpy(out.data() + size, &word, sizeof(Word));
}

// Checks times and addresses before anything is written.
class WordEncoder : public EventEncoder {
 public:
  absl::Status Encode(absl::Span<const Event> events, std::vector<uint8_t>& out) final;
  absl::Status EncodeTime(int64_t t_us, std::vector<uint8_t>& out) final;

 protected:
  WordEncoder(SensorGeometry geometry, const TimeLimits& limits) : geometry_(geometry), limits_(limits) {}

  virtual void EncodeChecked(absl::Span<const Event> events, std::vector<uint8_t>& out) = 0;
  // Only called for encodings that have time words.
  virtual void EncodeCheckedTime(int64_t t_us, std::vector<uint8_t>& out) = 0;

  const SensorGeometry geometry_;

 private:
  absl::Status Check(absl::Span<const Event> events) const;
  // `event`: the index of the event whose time it is.
  static absl::Status CheckOrder(std::optional<size_t> event, int64_t t_us, int64_t previous_us);
  absl::Status CheckGap(std::optional<size_t> event, int64_t t_us, int64_t previous_us) const;

  const TimeLimits limits_;
  int64_t last_us_ = 0;
  int64_t last_written_us_ = -1;  // -1: nothing yet
};

// How many of the first events one vector word can hold: the same time, row, polarity and 32 aligned columns, from left
// to right, since a mask keeps no other order.
size_t VectorRunLength(absl::Span<const Event> events);
// Bit i: the pixel i columns right of the aligned base.
uint32_t VectorMask(absl::Span<const Event> run);

std::unique_ptr<EventEncoder> MakeEvt3Encoder(SensorGeometry geometry);
std::unique_ptr<EventEncoder> MakeEvt21Encoder(SensorGeometry geometry);
std::unique_ptr<EventEncoder> MakeEvt2Encoder(SensorGeometry geometry);
std::unique_ptr<EventEncoder> MakeFlat64Encoder(SensorGeometry geometry);

}  // namespace evpose
