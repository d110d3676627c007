// SPDX-License-Identifier: Apache-2.0

// EVT 2.0: 32-bit words; an event carries row, column and the lowest 6 bits of the time.
#include <cstdint>

#include "core/events/formats/evt2_word_decoder.h"

namespace evpose {
namespace {

class Evt2Decoder final : public Evt2WordDecoder {
 public:
  Evt2Decoder(SensorGeometry geometry, OutsideSensor outside)
      : Evt2WordDecoder(4, geometry, outside, BestWordRuns() != nullptr ? BestWordRuns()->evt2 : nullptr) {}

 private:
  size_t DecodeWords(const uint8_t* words, size_t count) override {
    Evt2Clock clock = clock_;
    Event* cursor = sink_.begin();
    for (size_t index = 0; index < count;) {
      const size_t end = DecodeRun(words, count, index, clock, cursor);
      for (; index < end; ++index) cursor = DecodeWord(LoadWord<uint32_t>(words + 4 * index), clock, cursor);
    }
    Finish(clock, cursor);
    return count;
  }

  Event* DecodeWord(uint32_t word, Evt2Clock& clock, Event* cursor) {
    const uint32_t type = word >> 28;
    if (type > evt2::kCdOn) return DecodeRareWord(type, word & 0xfffffff, clock, cursor);
    if (!has_time_) [[unlikely]] {
      ++counts_.dropped_before_time;
      return cursor;
    }
    if (!clock.SetLow((word >> 22) & 0x3f)) [[unlikely]]
      sink_.RestartMarks(cursor, clock.now_us());
    const uint32_t x = (word >> 11) & 0x7ff;
    const uint32_t y = word & 0x7ff;
    const bool inside = (x < width_) & (y < height_);
    StoreEvent(cursor, clock.now_us(), x, y, type);
    cursor += inside | keep_outside_;
    (keep_outside_ ? counts_.kept_outside_sensor : counts_.dropped_outside_sensor) += !inside;
    return cursor >= sink_.limit() ? sink_.Flush(cursor) : cursor;
  }
};

}  // namespace

std::unique_ptr<EventDecoder> MakeEvt2Decoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<Evt2Decoder>(geometry, outside);
}

}  // namespace evpose
