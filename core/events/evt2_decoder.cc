// EVT 2.0: 32-bit words; an event carries row, column and the lowest 6 bits of the time.
#include <cstdint>

#include "core/events/sensor_clock.h"
#include "core/events/word_decoder.h"
#include "core/events/word_runs.h"
#include "core/events/word_types.h"

namespace evpose {
namespace {

class Evt2Decoder final : public WordDecoder {
 public:
  Evt2Decoder(SensorGeometry geometry, OutsideSensor outside)
      : WordDecoder(4),
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
    uint64_t num_outside = 0;
    const bool keep_outside = keep_outside_;
    size_t index = 0;
    while (index < count) {
      if (has_runs_ && has_time_) {
        index += DecodeRun(words + 4 * index, count - index, clock, cursor);
        if (cursor >= sink_.limit()) cursor = sink_.Flush(cursor);
        if (index == count) break;
      }
      const uint32_t word = LoadWord<uint32_t>(words + 4 * index++);
      const uint32_t type = word >> 28;
      if (type <= evt2::kCdOn && has_time_) [[likely]] {
        if (!clock.SetLow((word >> 22) & 0x3f)) [[unlikely]]
          sink_.RestartMarks(cursor, clock.now_us());
        const uint32_t x = (word >> 11) & 0x7ff;
        const uint32_t y = word & 0x7ff;
        const bool inside = (x < width_) & (y < height_);
        *cursor = {clock.now_us(), static_cast<uint16_t>(x), static_cast<uint16_t>(y), static_cast<uint8_t>(type)};
        cursor += inside | keep_outside;
        num_outside += !inside;
        if (cursor >= sink_.limit()) [[unlikely]]
          cursor = sink_.Flush(cursor);
      } else {
        cursor = DecodeRareWord(type, word & 0xfffffff, clock, cursor);
      }
    }
    sink_.Flush(cursor);
    clock_ = clock;
    (keep_outside ? counts_.kept_outside_sensor : counts_.dropped_outside_sensor) += num_outside;
    counts_.cd_events = sink_.num_events();
    counts_.clock_wraps = clock.wraps();
    counts_.time_backsteps = clock.backsteps();
    return count;
  }

  // As many words as are a run; returns how many.
  size_t DecodeRun(const uint8_t* words, size_t count, Evt2Clock& clock, Event*& cursor) const {
    constexpr int64_t kMaxLow_us = 63;
    Evt2Run run = {width_, height_, clock.base_us(), clock.now_us() - clock.base_us()};
    if (run.low_us < 0 || run.low_us > kMaxLow_us) return 0;
    const size_t num_words = DecodeEvt2Run(words, count, run, cursor, sink_.limit());
    clock.SetLow(run.low_us);
    return num_words;
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
      case evt2::kCdOff:
      case evt2::kCdOn:  // only before the first TIME_HIGH
        ++counts_.dropped_before_time;
        return cursor;
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
  const bool has_runs_ = HasWordRuns();
  Evt2Clock clock_;
  bool has_time_ = false;
};

}  // namespace

std::unique_ptr<EventDecoder> MakeEvt2Decoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<Evt2Decoder>(geometry, outside);
}

}  // namespace evpose
