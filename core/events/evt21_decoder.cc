// EVT 2.1: 64-bit words, the upper half as in EVT 2.0, the lower half a mask of 32 pixels from the column on.
#include <algorithm>
#include <bit>
#include <cstdint>

#include "core/events/sensor_clock.h"
#include "core/events/word_decoder.h"
#include "core/events/word_types.h"

namespace evpose {
namespace {

class Evt21Decoder final : public WordDecoder {
 public:
  Evt21Decoder(SensorGeometry geometry, OutsideSensor outside)
      : WordDecoder(8),
        width_(static_cast<uint32_t>(geometry.width_px)),
        height_(static_cast<uint32_t>(geometry.height_px)),
        keep_outside_(outside == OutsideSensor::kKeep) {}

  void SaveState(StateWriter& writer) const override { VisitState(writer, *this); }
  void LoadState(StateReader& reader) override { VisitState(reader, *this); }
  static void VisitState(auto& archive, auto& self) {
    VisitWords(archive, self);
    archive(self.clock_, self.has_time_);
  }

 private:
  size_t DecodeWords(const uint8_t* words, size_t count) override {
    Evt2Clock clock = clock_;
    Event* cursor = sink_.begin();
    for (size_t index = 0; index < count; ++index) {
      const uint64_t word = LoadWord<uint64_t>(words + 8 * index);
      const auto upper = static_cast<uint32_t>(word >> 32);
      const uint32_t type = upper >> 28;
      if (type <= evt2::kCdOn) [[likely]] {
        cursor = DecodeVector(type, upper, static_cast<uint32_t>(word), clock, cursor);
      } else {
        cursor = DecodeRareWord(type, upper & 0xfffffff, clock, cursor);
      }
    }
    sink_.Flush(cursor);
    clock_ = clock;
    counts_.cd_events = sink_.num_events();
    counts_.clock_wraps = clock.wraps();
    counts_.time_backsteps = clock.backsteps();
    return count;
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
      const auto x = static_cast<uint16_t>(base + static_cast<uint32_t>(std::countr_zero(mask)));
      *cursor++ = {t_us, x, static_cast<uint16_t>(y), static_cast<uint8_t>(type)};
    }
    return cursor >= sink_.limit() ? sink_.Flush(cursor) : cursor;
  }

  // A bit for each of the 32 pixels from `base` on that the sensor has.
  uint32_t PixelsInside(uint32_t base, uint32_t y) const {
    if (y >= height_ || base >= width_) return 0;
    const uint32_t num_pixels = std::min(width_ - base, 32u);
    return static_cast<uint32_t>((uint64_t{1} << num_pixels) - 1);
  }

  Event* DecodeRareWord(uint32_t type, uint32_t content, Evt2Clock& clock, Event* cursor) {
    switch (type) {
      case evt2::kTimeHigh: {
        const bool was_started = clock.started();
        has_time_ = true;
        if (!clock.SetHigh(content) || !was_started) {
          sink_.RestartMarks(cursor, clock.now_us());
        } else if (clock.now_us() >= sink_.mark_due_us()) {
          return sink_.MarkTime(cursor, clock.now_us());
        }
        return cursor;
      }
      case evt2::kExtTrigger:
        if (!has_time_) {
          ++counts_.dropped_before_time;
          return cursor;
        }
        if (!clock.SetLow((content >> 22) & 0x3f)) sink_.RestartMarks(cursor, clock.now_us());
        sink_.AddTrigger(
            {clock.now_us(), static_cast<uint8_t>((content >> 8) & 0x1f), static_cast<uint8_t>(content & 1)});
        ++counts_.triggers;
        return cursor;
      case evt2::kOthers:
      case evt2::kContinued:
        return cursor;
      default:
        ++counts_.unknown_words;
        return cursor;
    }
  }

  void Forget() override { has_time_ = false; }

  const uint32_t width_;
  const uint32_t height_;
  const bool keep_outside_;
  Evt2Clock clock_;
  bool has_time_ = false;
};

}  // namespace

std::unique_ptr<EventDecoder> MakeEvt21Decoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<Evt21Decoder>(geometry, outside);
}

}  // namespace evpose
