// SPDX-License-Identifier: Apache-2.0

// Encoders of EVT 2.0 and EVT 2.1, which differ in the width of their words and in the mask of 32 pixels.
#include <cstdint>

#include "core/events/word_encoder.h"
#include "core/events/word_types.h"

namespace evpose {
namespace {

constexpr int64_t kEvt2HighRange = int64_t{1} << 28;  // values of TIME_HIGH, which has 28 bits

template <typename Word>
class Evt2Encoder final : public WordEncoder {
 public:
  explicit Evt2Encoder(SensorGeometry geometry) : WordEncoder(geometry, {.num_trigger_inputs = 32}) {}

 private:
  static constexpr bool kVectors = sizeof(Word) == 8;

  void EncodeChecked(absl::Span<const Event> events, std::vector<uint8_t>& out) override {
    while (!events.empty()) {
      const Event& first = events.front();
      if (first.t_us / kTimeWordPeriodUs != t_us_ / kTimeWordPeriodUs || t_us_ < 0) WriteTime(first.t_us, out);
      t_us_ = first.t_us;
      const size_t length = kVectors ? VectorRunLength(events) : 1;
      const uint32_t x = kVectors ? first.x / kVectorPixels * kVectorPixels : first.x;
      const auto low = static_cast<uint32_t>(first.t_us & 0x3f);
      Append(first.polarity, low << 22 | x << 11 | first.y, VectorMask(events.subspan(0, length)), out);
      events.remove_prefix(length);
    }
  }

  void EncodeCheckedTime(int64_t t_us, std::vector<uint8_t>& out) override {
    if (t_us >> 6 != t_us_ >> 6) WriteTime(t_us, out);
    t_us_ = t_us;
  }

  void EncodeCheckedTrigger(const Trigger& trigger, std::vector<uint8_t>& out) override {
    EncodeCheckedTime(trigger.t_us, out);
    const auto low = static_cast<uint32_t>(trigger.t_us & 0x3f);
    Append(evt2::kExtTrigger, low << 22 | static_cast<uint32_t>(trigger.id) << 8 | trigger.polarity, 0, out);
  }

  void WriteTime(int64_t t_us, std::vector<uint8_t>& out) {
    const int64_t high = t_us >> 6;
    // Decoders recognise a wrap by a step back of nearly the whole range: a gap over a wrap needs the last TIME_HIGH
    // before it and the first one after it.
    for (int64_t wraps = t_us_ < 0 ? 0 : (t_us_ >> 6) / kEvt2HighRange; wraps < high / kEvt2HighRange; ++wraps) {
      Append(evt2::kTimeHigh, static_cast<uint32_t>(kEvt2HighRange - 1), 0, out);
      Append(evt2::kTimeHigh, 0, 0, out);
    }
    Append(evt2::kTimeHigh, static_cast<uint32_t>(high % kEvt2HighRange), 0, out);
  }

  static void Append(uint32_t type, uint32_t content, uint32_t mask, std::vector<uint8_t>& out) {
    const uint32_t word = type << 28 | content;
    if constexpr (kVectors) {
      AppendWord(static_cast<uint64_t>(word) << 32 | mask, out);
    } else {
      AppendWord(word, out);
    }
  }

  int64_t t_us_ = -1;
};

}  // namespace

std::unique_ptr<EventEncoder> MakeEvt2Encoder(SensorGeometry geometry) {
  return std::make_unique<Evt2Encoder<uint32_t>>(geometry);
}
std::unique_ptr<EventEncoder> MakeEvt21Encoder(SensorGeometry geometry) {
  return std::make_unique<Evt2Encoder<uint64_t>>(geometry);
}

}  // namespace evpose
