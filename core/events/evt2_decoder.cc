// SPDX-License-Identifier: Apache-2.0

// EVT 2.0: 32-bit words; an event carries row, column and the lowest 6 bits of the time. EVT 2.1: 64-bit words, the
// upper half as in EVT 2.0, the lower half a mask of 32 pixels from the column on.
#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "core/events/sensor_clock.h"
#include "core/events/word_decoder.h"
#include "core/events/word_runs.h"
#include "core/events/word_types.h"

namespace evpose {
namespace {

template <typename Word>
class Evt2Decoder final : public WordDecoder {
  static_assert(kMaxRunBlock <= EventSink::kMaxEventsOfWord);
  static constexpr bool kVectors = sizeof(Word) == 8;

 public:
  Evt2Decoder(SensorGeometry geometry, OutsideSensor outside) : WordDecoder(sizeof(Word), geometry, outside) {
    if (const WordRuns* const best = BestWordRuns()) runs_ = kVectors ? best->evt21 : best->evt2;
  }

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
    for (size_t index = 0; index < count;) {
      const size_t end = DecodeRun(words, count, index, clock, cursor);
      for (; index < end; ++index) cursor = DecodeWord(LoadWord<Word>(words + sizeof(Word) * index), clock, cursor);
    }
    sink_.Flush(cursor);
    clock_ = clock;
    UpdateCounts(clock);
    return count;
  }

  // Decodes the run that begins at word `index`, if any, and moves `index`. Returns the index of the word, at most
  // `count`, at which to look for the next run (RunPause).
  size_t DecodeRun(const uint8_t* words, size_t count, size_t& index, Evt2Clock& clock, Event*& cursor) {
    constexpr int64_t kMaxLowUs = 63;  // the 6 low bits of the time in an event word
    if (runs_ == nullptr) return count;
    Evt2Run run = {width_, height_, clock.base_us(), sink_.mark_due_us(), clock.now_us() - clock.base_us()};
    size_t num_words = 0;
    // A loaded state may have any times.
    const bool is_of_base = run.low_us >= 0 && run.low_us <= kMaxLowUs && (run.base_us & kMaxLowUs) == 0;
    if (has_time_ && is_of_base) {
      num_words = runs_(words + sizeof(Word) * index, count - index, run, cursor, sink_.limit());
      clock.SetLow(run.low_us);
      if (cursor >= sink_.limit()) cursor = sink_.Flush(cursor);
    }
    index += num_words;
    return index + std::min(pause_.WordsAfter(num_words), count - index);
  }

  Event* DecodeWord(Word word, Evt2Clock& clock, Event* cursor) {
    const auto upper = static_cast<uint32_t>(word >> (8 * sizeof(Word) - 32));
    const uint32_t type = upper >> 28;
    if (type > evt2::kCdOn) return DecodeRareWord(type, upper & 0xfffffff, clock, cursor);
    if (!has_time_) [[unlikely]] {
      counts_.dropped_before_time += static_cast<uint64_t>(kVectors ? std::popcount(static_cast<uint32_t>(word)) : 1);
      return cursor;
    }
    if (!clock.SetLow((upper >> 22) & 0x3f)) [[unlikely]]
      sink_.RestartMarks(cursor, clock.now_us());
    const uint32_t x = (upper >> 11) & 0x7ff;
    const uint32_t y = upper & 0x7ff;
    if constexpr (kVectors) {
      cursor = StoreVector(x, y, static_cast<uint32_t>(word), type, clock.now_us(), cursor);
    } else {
      const bool inside = (x < width_) & (y < height_);
      StoreEvent(cursor, clock.now_us(), x, y, type);
      cursor += inside | keep_outside_;
      CountOutside(!inside);
    }
    return cursor >= sink_.limit() ? sink_.Flush(cursor) : cursor;
  }

  // Stores the events of the pixels of a mask, which begins at column `base`.
  Event* StoreVector(uint32_t base, uint32_t y, uint32_t mask, uint32_t polarity, int64_t t_us, Event* cursor) {
    const uint32_t inside = mask & PixelsInside(base, y);
    if (inside != mask) [[unlikely]] {
      CountOutside(static_cast<uint64_t>(std::popcount(mask & ~inside)));
      if (!keep_outside_) mask = inside;
    }
    for (; mask != 0; mask &= mask - 1) {
      const uint32_t x = base + static_cast<uint32_t>(std::countr_zero(mask));
      StoreEvent(cursor++, t_us, x, y, polarity);
    }
    return cursor;
  }

  // The mask of those of the 32 pixels from `base` on that lie on the sensor.
  uint32_t PixelsInside(uint32_t base, uint32_t y) const {
    if (y >= height_ || base >= width_) return 0;
    const uint32_t num_pixels = std::min(width_ - base, 32u);
    return static_cast<uint32_t>((uint64_t{1} << num_pixels) - 1);
  }

  // Decodes a word (EVT2.1: the upper half of a word) that is not an event.
  Event* DecodeRareWord(uint32_t type, uint32_t content, Evt2Clock& clock, Event* cursor) {
    switch (type) {
      case evt2::kTimeHigh: {
        const bool was_started = clock.started();
        has_time_ = true;
        const bool continues = clock.SetHigh(content) && was_started;
        return sink_.SetTime(continues, clock.now_us(), cursor);
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

  void DiscardState() override { has_time_ = false; }

  DecodeRunOf<Evt2Run> runs_ = nullptr;
  Evt2Clock clock_;
  bool has_time_ = false;
  RunPause pause_;  // not saved: it does not influence the events
};

}  // namespace

std::unique_ptr<EventDecoder> MakeEvt2Decoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<Evt2Decoder<uint32_t>>(geometry, outside);
}
std::unique_ptr<EventDecoder> MakeEvt21Decoder(SensorGeometry geometry, OutsideSensor outside) {
  return std::make_unique<Evt2Decoder<uint64_t>>(geometry, outside);
}

}  // namespace evpose
