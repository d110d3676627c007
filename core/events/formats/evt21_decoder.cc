// SPDX-License-Identifier: Apache-2.0

// EVT 2.1: 64-bit words, the upper half as in EVT 2.0, the lower half a mask of 32 pixels from the column on.
#include <algorithm>
#include <bit>
#include <cstdint>

#include "core/events/formats/evt2_word_decoder.h"

namespace evpose {
namespace {

class Evt21Decoder final : public Evt2WordDecoder {
 public:
  Evt21Decoder(SensorGeometry geometry, OutsideSensor outside)
      : Evt2WordDecoder(8, geometry, outside, BestWordRuns() != nullptr ? BestWordRuns()->evt21 : nullptr) {}

 private:
  size_t DecodeWords(const uint8_t* words, size_t count) override {
    Evt2Clock clock = clock_;
    Event* cursor = sink_.begin();
    for (size_t index = 0; index < count;) {
      const size_t end = DecodeRun(words, count, index, clock, cursor);
      for (; index < end; ++index) cursor = DecodeWord(LoadWord<uint64_t>(words + 8 * index), clock, cursor);
    }
    Finish(clock, cursor);
    return count;
  }

  Event* DecodeWord(uint64_t word, Evt2Clock& clock, Event* cursor) {
    const auto upper = static_cast<uint32_t>(word >> 32);
    const uint32_t type = upper >> 28;
    if (type > evt2::kCdOn) [[unlikely]]
      return DecodeRareWord(type, upper & 0xfffffff, clock, cursor);
    return DecodeVector(type, upper, static_cast<uint32_t>(word), clock, cursor);
  }

  Event* DecodeVector(uint32_t type, uint32_t upper, uint32_t mask, Evt2Clock& clock, Event* cursor) {
    if (!has_time_) [[unlikely]] {
      counts_.dropped_before_time += static_cast<uint64_t>(std::popcount(mask));
      return cursor;
    }
    if (!clock.SetLow((upper >> 22) & 0x3f)) [[unlikely]]
      sink_.RestartMarks(cursor, clock.now_us());
    const uint32_t base = (upper >> 11) & 0x7ff;
    const uint32_t y = upper & 0x7ff;
    const uint32_t inside = mask & PixelsInside(base, y);
    if (inside != mask) [[unlikely]] {
      const auto num_outside = static_cast<uint64_t>(std::popcount(mask & ~inside));
      (keep_outside_ ? counts_.kept_outside_sensor : counts_.dropped_outside_sensor) += num_outside;
      if (!keep_outside_) mask = inside;
    }
    const int64_t t_us = clock.now_us();
    for (; mask != 0; mask &= mask - 1) {
      const uint32_t x = base + static_cast<uint32_t>(std::countr_zero(mask));
      StoreEvent(cursor++, t_us, x, y, type);
    }
    return cursor >= sink_.limit() ? sink_.Flush(cursor) : cursor;
  }

  // The mask of those of the 32 pixels from `base` on that lie on the sensor.
  uint32_t PixelsInside(uint32_t base, uint32_t y) const {
    if (y >= height_ || base >= width_) return 0;
    const uint32_t num_pixels = std::min(width_ - base, 32u);
    return static_cast<uint32_t>((uint64_t{1} << num_pixels) - 1);
  }
};

}  // namespace

std::unique_ptr<EventDecoder> MakeEvt21Decoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<Evt21Decoder>(geometry, outside);
}

}  // namespace evpose
